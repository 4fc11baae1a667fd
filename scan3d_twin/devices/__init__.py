"""Devices, one folder per family: data sheet, codec, driver and emulator."""
