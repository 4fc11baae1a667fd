"""LDROBOT LD06, LD19 and STL27L: their stream of packets, its driver and its emulator."""

LIDARS = {"ld06": "LD06", "ld19": "LD19", "stl27l": "STL27L"}
REFUSED = {
    # lds2d
    r"ld14p?": "its motor has to be commanded, which only one source describes; take ld06, ld19 or "
    "stl27l",
    # lidar-LD19-tutorial issue 2
    r"coind4\w*": "it speaks another protocol (AA 55), though it is sold as LD19; take an ld19 "
    "whose packets begin with 54 2C",
}
