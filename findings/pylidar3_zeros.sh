#!/bin/sh
# PyLidar3 1.6 averages samples without an echo, which a YDLIDAR X4 sends as distance 0, with those that have
# one: where every second sample hits a wall at 2 m, it reports a wall at 1 m. The distances are in millimetres,
# though its manual says metres. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet PyLidar3==1.6 pyserial==3.5
cd "$folder"
bin/python - <<'PY'
import math
import struct
import sys

import PyLidar3

STEP = 0.5
"""Degrees between samples."""


def packet(first, distances):
    """Return a valid X4 packet of samples from an angle on; the lidar corrects the angles by the distance."""

    def angle(index):
        distance = distances[index]
        bend = math.degrees(math.atan(21.8 * (155.3 - distance) / (155.3 * distance))) if distance else 0.0
        return round(((first + index * STEP - bend) % 360) * 64) << 1 | 1

    words = [angle(0), angle(len(distances) - 1), *(distance * 4 for distance in distances)]
    head = struct.pack("<BB", 0, len(distances))
    check = 0x55AA ^ int.from_bytes(head, "little")
    for word in words:
        check ^= word
    return b"\xaa\x55" + head + struct.pack("<HHH", *words[:2], check) + struct.pack(f"<{len(words) - 2}H", *words[2:])


class Port:
    def __init__(self, pattern):
        turn = b"".join(packet(first, pattern * 10) for first in range(0, 360, 10))
        self.data = turn * 3

    def setDTR(self, state):
        pass

    def write(self, data):
        pass

    def reset_input_buffer(self):
        pass

    def read(self, count):
        return self.data[:count] if count > 7 else bytes(7)


middle = {}
for name, pattern in {"all samples at 2000 mm": [2000, 2000], "every second one without echo": [2000, 0]}.items():
    lidar = PyLidar3.YdLidarX4("fake")
    lidar._s, lidar._is_connected = Port(pattern), True
    scan = next(lidar.StartScanning())
    seen = sorted(distance for distance in scan.values() if distance)
    middle[name] = seen[len(seen) // 2]
    print(f"{name}: {len(seen)} angles with a distance, the middle one {middle[name]}")
sys.exit(0 if list(middle.values()) == [2000, 1000] else 1)
PY
echo "as described"
