"""Slamtec RPLIDAR A1, C1 and S2: their protocol, driver and emulator."""
