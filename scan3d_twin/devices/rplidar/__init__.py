"""Slamtec RPLIDAR A1, C1 and S2: their protocol, driver and emulator."""

LIDARS = {"rplidar_a1": "RPLIDAR_A1", "rplidar_c1": "RPLIDAR_C1", "rplidar_s2": "RPLIDAR_S2"}
