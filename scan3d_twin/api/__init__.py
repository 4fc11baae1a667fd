"""Whole runs across several packages: digitise, watch, save, resume."""
