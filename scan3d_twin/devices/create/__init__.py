"""iRobot Create 1, Create 2 and Roomba 500 to 800: the Open Interface, its driver and emulator."""

BASES = {
    "create1": "CREATE1",
    "create2": "CREATE2",
    "roomba500": "ROOMBA500",
    "roomba600": "ROOMBA600",
    "roomba700": "ROOMBA700",
    "roomba800": "ROOMBA800",
}
REFUSED = {
    r"roomba": "name its series, by the number on its underside: roomba500 to roomba800",
    # libcreate issue 23
    r"roomba4\d\d": "a Roomba 400 speaks the older serial interface: it has no stream of "
    "readings and no encoder counts; take a Roomba 500 to 800",
    # create_robot issue 106; dorita980 issue 56; no manual of iRobot's was found
    r"roomba9\d\d": "no source says what a Roomba 900 sends: the one that was tried does not "
    "answer like a Create 2; take a Roomba 500 to 800",
}
