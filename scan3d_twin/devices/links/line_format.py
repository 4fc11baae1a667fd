"""How serial lines frame a byte; it imports nothing, so that codecs and settings can use it."""

BITS_PER_BYTE = 10
"""8N1: start bit, eight data bits, stop bit."""
