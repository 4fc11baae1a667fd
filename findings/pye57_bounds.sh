#!/bin/sh
# pye57 0.4.19 moves the bounds of a scan by its pose: write_scan_raw names those of the points in the
# file's frame, though ASTM E2807 has cartesianBounds in the scan's own. It also claims 0 degC, 0 Pa and
# the year 1980 of every scan. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet pye57==0.4.19
cat > look.py <<'EOF'
import sys

import numpy as np
import pye57

points = np.array([[1.0, 0.0, 0.0], [2.0, 1.0, 1.0]])
file = pye57.E57("scan.e57", mode="w")
file.write_scan_raw(
    {f"cartesian{axis}": points[:, k].copy() for k, axis in enumerate("XYZ")},
    rotation=np.array([1.0, 0.0, 0.0, 0.0]),
    translation=np.array([10.0, 0.0, 0.0]),
)
file.close()
file = pye57.E57("scan.e57")
header, data = file.get_header(0), file.read_scan_raw(0)
told, own = header.xMinimum, float(data["cartesianX"].min())
print(f"x of the scan's own points begins at {own}, its header says {told}")
print(f"temperature {header.temperature} degC, pressure {header.atmosphericPressure} Pa")
sys.exit(0 if told == 11.0 and own == 1.0 else 1)
EOF
here/bin/python look.py
