#!/bin/sh
# pycreate2 0.8.0 swaps left and right of the bumpers and the wheel drops, and looks for the overcurrents of main
# brush and wheels one bit too low: the left wheel's is lost, the main brush's is called the right wheel's. The
# Open Interface has the right bumper in bit 0 of packet 7, and in packet 14 the main brush in bit 2, the right
# wheel in bit 3, the left wheel in bit 4. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet pycreate2==0.8.0
cd "$folder"
bin/python - <<'PY'
import sys

from pycreate2.packets import SensorPacketDecoder

BUMPS, OVERCURRENTS = 0, 7
"""Where packets 7 and 14 lie in the 80 bytes of packet 100."""


def told(place, bit):
    data = bytearray(80)
    data[place] = 1 << bit
    sensors = SensorPacketDecoder(bytes(data))
    flags = sensors.bumps_wheeldrops if place == BUMPS else sensors.overcurrents
    return [name for name, is_set in flags._asdict().items() if is_set]


CASES = (
    (BUMPS, 0, "right bumper", ["bump_left"]),
    (BUMPS, 1, "left bumper", ["bump_right"]),
    (BUMPS, 2, "right wheel drop", ["wheeldrop_left"]),
    (BUMPS, 3, "left wheel drop", ["wheeldrop_right"]),
    (OVERCURRENTS, 2, "main brush overcurrent", ["right_wheel_overcurrent"]),
    (OVERCURRENTS, 3, "right wheel overcurrent", ["left_wheel_overcurrent"]),
    (OVERCURRENTS, 4, "left wheel overcurrent", []),
)
found = []
for place, bit, meant, _ in CASES:
    found.append(told(place, bit))
    print(f"{meant} (bit {bit}) is read as {', '.join(found[-1]) or 'nothing'}")
sys.exit(0 if found == [expected for *_, expected in CASES] else 1)
PY
echo "as described"
