"""iRobot Create 1, Create 2 and Roomba 500 and 600: the Open Interface, its driver and emulator."""

BASES = {"create1": "CREATE1", "create2": "CREATE2"}
