"""The simulated lidar: motion, geometry, optics and firmware of a reading."""
