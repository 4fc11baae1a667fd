"""Robotis Dynamixel XL330, a servo as a turntable: protocol 2.0, its driver and its emulator."""

TURNTABLES = {"xl330": "XL330"}
