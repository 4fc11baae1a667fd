"""The real robot: serial drivers behind the hardware interface."""
