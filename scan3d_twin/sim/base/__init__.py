"""The simulated base: drive, odometry, safety sensors and the errors of its motion."""
