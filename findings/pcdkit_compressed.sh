#!/bin/sh
# pcdkit 0.2.14 writes binary_compressed PCD files point by point (x y z x y z), while the format, and its own
# reader, have them field by field (all x, all y, all z): the coordinates come back exchanged between points,
# without an error. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet pcdkit==0.2.14 pypcd4==1.5.1
cat > look.py <<'PY'
import sys
from pathlib import Path

import numpy as np
import pcdkit
import pypcd4

points = np.array([(1, 2, 3), (4, 5, 6), (7, 8, 9)], dtype=[(axis, "<f4") for axis in "xyz"])
cloud = pcdkit.from_array(points)
own, others = {}, {}
for encoding in ("binary", "binary_compressed"):
    path = Path(f"{encoding}.pcd")
    cloud.save(path, format=encoding)
    own[encoding] = [list(map(float, point)) for point in pcdkit.load_pcd_from_path(path).pc_data]
    others[encoding] = pypcd4.PointCloud.from_path(path).numpy().tolist()
    print(f"{encoding}: pcdkit reads {own[encoding]}, pypcd4 {others[encoding]}")
rows = [list(map(float, point)) for point in points]
columns = [list(column) for column in zip(*rows)]
is_kept = own["binary"] == others["binary"] == rows
is_exchanged = own["binary_compressed"] == others["binary_compressed"] == columns
sys.exit(0 if is_kept and is_exchanged else 1)
PY
here/bin/python look.py
echo "as described: x, y and z are exchanged between the points"
