#!/bin/sh
# lds2d 0.7.0 never yields a scan of a Neato XV11 or Xiaomi LDS01RR: `scans()` waits for the angle to drop by
# more than 180 degrees, but this driver mirrors its angles, so they count down and jump up at the end of a
# turn. The points of all turns gather in memory; `points()` works. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet lds2d==0.7.0
cd "$folder"
bin/python - <<'PY'
import sys

from lds2d import Lidar

TURNS = 10


def packet(index):
    """Return a valid packet of 4 points at 1000 mm, at 300 turns a minute."""
    body = bytes([0xFA, 0xA0 + index]) + (300 * 64).to_bytes(2, "little") + bytes.fromhex("E8033200") * 4
    total = 0
    for k in range(0, 20, 2):
        total = (total << 1) + int.from_bytes(body[k : k + 2], "little")
    return body + (((total & 0x7FFF) + (total >> 15)) & 0x7FFF).to_bytes(2, "little")


class Transport:
    def __init__(self):
        self.data = b"".join(map(packet, range(90))) * TURNS

    def read(self, count):
        if not self.data:
            raise EOFError
        chunk, self.data = self.data[:count], self.data[count:]
        return chunk


class Motor:
    def set_duty(self, duty):
        pass


def count(model, way):
    found = 0
    try:
        for _ in getattr(Lidar.open(model, transport=Transport(), motor=Motor()), way)():
            found += 1
    except EOFError:
        return found


found = {}
for model in ("NEATO-XV11", "XIAOMI-LDS01RR", "XIAOMI-LDS02RR"):
    found[model] = count(model, "points"), count(model, "scans")
    print(f"{model}: of {TURNS} turns, {found[model][0]} points and {found[model][1]} scans")
mirrored = (360 * TURNS, 0)
is_described = found == {
    "NEATO-XV11": mirrored,
    "XIAOMI-LDS01RR": mirrored,
    "XIAOMI-LDS02RR": (360 * TURNS, TURNS - 1),
}
sys.exit(0 if is_described else 1)
PY
echo "as described"
