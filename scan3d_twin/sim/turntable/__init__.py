"""The simulated turntable: a servo that turns the lidar on its base."""
