"""Codecs and constants of the devices: bytes to values and back, no I/O."""
