"""Recorded runs: the session file, its formats and exports, replay and resume."""
