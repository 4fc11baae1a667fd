"""Hokuyo URG-04LX: SCIP, its driver and its emulator."""

LIDARS = {"urg04lx": "URG04LX"}
