#!/bin/sh
# rplidarc1 0.1.3 keeps the check bit of a standard node in its angle and loses a bit: 1 degree reads
# 0 degrees, 123.5 degrees 123. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet rplidarc1==0.1.3
cd "$folder"
bin/python - <<'EOF'
import sys

from rplidarc1.protocol import Response

found = []
for degrees in (1.0, 123.5):
    angle = round(degrees * 64)
    # A valid node: quality 47, not the first of a turn, check bit 1, 1500.25 mm
    node = bytes([47 << 2 | 2]) + (angle << 1 | 1).to_bytes(2, "little") + (6001).to_bytes(2, "little")
    quality, read, mm = Response._parse_simple_scan_result(node)
    found.append(read)
    print(f"{degrees} degrees are read as {read} (quality {quality}, {mm} mm)")
sys.exit(0 if found != [1.0, 123.5] else 1)
EOF
echo "as described: the angle loses its lowest whole bit"
