"""The pure half of the house: scanning, registration and planning without I/O or hardware."""
