"""The simulated lidar: motion, geometry, optics, noise and firmware of a reading."""
