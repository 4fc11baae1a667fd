#!/bin/sh
# pyrplidar 0.1.2 reads the distances of a dense capsule (0x85, RPLIDAR C1 and S2) high byte first; the
# lidar sends the low byte first: 1000 mm become 59395 mm. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet pyrplidar==0.1.2
cd "$folder"
bin/python - <<'EOF'
import sys

from pyrplidar_protocol import PyRPlidarScanDenseCapsule

# Valid capsules: start 10 and 38.8 degrees, 40 samples of 1000 mm
frames = []
for start in (640, 2483):
    body = start.to_bytes(2, "little") + 40 * (1000).to_bytes(2, "little")
    check = 0
    for byte in body:
        check ^= byte
    frames.append(bytes([0xA0 | check & 15, 0x50 | check >> 4]) + body)
first, second = map(PyRPlidarScanDenseCapsule, frames)
nodes = PyRPlidarScanDenseCapsule._parse_capsule(first, second)
mm = nodes[0].dist_mm_q2 / 4
print(f"1000 mm are read as {mm:.0f} mm")
sys.exit(0 if mm == 59395 else 1)
EOF
echo "as described: the bytes of the distances are swapped"
