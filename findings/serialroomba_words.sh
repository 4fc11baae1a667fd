#!/bin/sh
# serialroomba 0.1.2 packs and unpacks 16-bit words as they lie in the memory of the computer: low byte first, and
# with a padding byte after the opcode, where the Open Interface has the high byte first and no padding. Commands
# of 0 to 255 survive by chance; "-100 mm/s on both wheels" turns the right one forwards at 156 mm/s, and
# 16000 mV are read as 32830. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet serialroomba==0.1.2 pyserial==3.5
cd "$folder"
bin/python - <<'PY'
import struct
import sys

from serialroomba.controllers.movement import MovementCommand
from serialroomba.controllers.serial import SerialController
from serialroomba.serialroomba import SerialRoomba

VOLTAGE, DISTANCE = b"\x8e\x16", b"\x8e\x13"
ANSWERS = {VOLTAGE: struct.pack(">H", 16000), DISTANCE: struct.pack(">h", -2)}
"""A base with 16 V that has gone 2 mm backwards."""


class Base:
    is_open = True

    def open(self):
        pass

    def write(self, data):
        self.sent, self.reply = data, ANSWERS.get(data, b"")

    def read(self, count):
        return self.reply[:count]


base = SerialController.connection = Base()
roomba = SerialRoomba("base")
driven = {}
for speed in (100, -100):
    roomba.movement_controller.send_command(MovementCommand.DRIVE_DIRECT, [speed, speed])
    driven[speed] = struct.unpack(">hh", base.sent[1:5])
    right, left = driven[speed]
    print(f"{speed} mm/s on both wheels: sent {base.sent.hex(' ')}: the base reads {right} (right) and {left} (left)")
    print(f"  the manual has {struct.pack('>Bhh', 145, speed, speed).hex(' ')}")
voltage = roomba.power_controller.battery_voltage_mV
distance = roomba.movement_controller.distance_travelled
print(f"16000 mV are read as {voltage}, -2 mm as {distance}")
is_described = driven == {100: (100, 100), -100: (156, -100)} and (voltage, distance) == (32830, -257)
sys.exit(0 if is_described else 1)
PY
echo "as described"
