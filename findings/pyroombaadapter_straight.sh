#!/bin/sh
# pyroombaadapter 0.3.0 cannot drive straight with `move`: for `move(0.1, 0.0)`, "move straight" in its manual,
# it clamps 32768, the radius that the Open Interface reserves for straight, to 2000 mm, a bend to the left.
# Wider bends are clamped, too. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet pyroombaadapter==0.3.0
cd "$folder"
bin/python - <<'PY'
import math
import os
import struct
import sys
import time

from pyroombaadapter import PyRoombaAdapter

robot, port = os.openpty()
adapter = PyRoombaAdapter(os.ttyname(port))
os.read(robot, 100)


def sent(velocity, yaw_rate):
    adapter.move(velocity, yaw_rate)
    time.sleep(0.1)
    opcode, speed, radius = struct.unpack(">Bhh", os.read(robot, 100))
    assert opcode == 137, "the Drive command"
    return speed, radius


found = []
for velocity, yaw_rate in ((0.1, 0.0), (-0.1, 0.0), (0.2, 0.05)):
    speed, radius = sent(velocity, yaw_rate)
    found.append(radius)
    turn = "nothing" if radius in (32767, -32768) else f"{math.degrees(speed / radius):.2f} degrees"
    asked = math.degrees(yaw_rate)
    print(f"move({velocity}, {yaw_rate}): {speed} mm/s, radius {radius} mm: {turn} a second, not {asked:.2f}")
sys.exit(0 if found == [2000, 2000, 2000] else 1)
PY
echo "as described"
