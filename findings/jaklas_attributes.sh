#!/bin/sh
# jaklas 0.4.4 drops attributes that its manual lists as written: point_source_id, user_data, the return numbers
# and the scan angle come back as zeros, without a warning, while a column that LAS does not know ("ring") is
# kept. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet jaklas==0.4.4 laspy==2.7.0
cat > look.py <<'PY'
import sys

import jaklas
import laspy
import numpy as np

KEPT = {
    "intensity": np.array([100, 200, 300], "u2"),
    "classification": np.array([1, 2, 6], "u1"),
    "ring": np.array([4, 5, 6], "u1"),
}
LOST = {
    "point_source_id": np.array([11, 12, 13], "u2"),
    "user_data": np.array([21, 22, 23], "u1"),
    "return_number": np.array([1, 2, 1], "u1"),
    "number_of_returns": np.array([2, 2, 1], "u1"),
    "scan_angle_rank": np.array([-30, 10, 30], "i1"),
}
places = {axis: np.array([0.0, 1.0, 2.0]) for axis in "xyz"}
jaklas.write({**places, **KEPT, **LOST}, "scan.las")
las = laspy.read("scan.las")
read = {name: np.asarray(las[name]).tolist() for name in (*KEPT, *LOST)}
for name, values in {**KEPT, **LOST}.items():
    print(f"{name}: written {values.tolist()}, read {read[name]}")
are_kept = all(read[name] == values.tolist() for name, values in KEPT.items())
are_lost = all(read[name] == [0, 0, 0] for name in LOST)
sys.exit(0 if are_kept and are_lost else 1)
PY
here/bin/python look.py
echo "as described"
