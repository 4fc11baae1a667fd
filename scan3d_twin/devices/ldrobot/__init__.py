"""LDROBOT LD06, LD19 and STL27L: their stream of packets, its driver and its emulator."""

LIDARS = {"ld06": "LD06", "ld19": "LD19", "stl27l": "STL27L"}
