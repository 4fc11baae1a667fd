"""Calibration of the lidar's mount and of the base's turns, and of a turntable."""
