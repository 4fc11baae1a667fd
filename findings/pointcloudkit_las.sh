#!/bin/sh
# pointcloudkit 0.1.0 rounds coordinates to whole centimetres in a LAS file, whatever the cloud: it keeps the
# scale of 0.01 that laspy's header begins with, and its manual does not say so. A scan of an object loses up
# to 5 mm an axis; the same cloud as PLY keeps its doubles. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet pointcloudkit==0.1.0 laspy==2.7.0
cat > look.py <<'PY'
import sys

import numpy as np
from pointcloudkit import PointCloud

points = np.random.default_rng(1).uniform(0.0, 0.2, (1000, 3))
PointCloud(position=points).write("scan.ply")
PointCloud.read("scan.ply").write("scan.las")
off = {}
for name in ("scan.ply", "scan.las"):
    read = PointCloud.read(name).position
    off[name] = float(np.abs(read - points).max())
    places = len(np.unique(read, axis=0))
    print(f"{name}: up to {1000 * off[name]:.2f} mm off, {places} places of {len(points)}")
sys.exit(0 if off["scan.ply"] == 0 and 0.0045 < off["scan.las"] <= 0.0051 else 1)
PY
here/bin/python look.py
echo "as described"
