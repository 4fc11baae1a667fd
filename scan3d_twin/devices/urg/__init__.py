"""Hokuyo URG-04LX: SCIP, its driver and its emulator."""
