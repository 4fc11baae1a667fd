#!/bin/sh
# pyntcloud 0.3.1 declares every unsigned column of a PLY file as uchar and every signed one as int, but writes it
# as wide as it is: with the 16-bit intensity of a LAS file, all points after the first of the binary PLY file are
# wrong, for itself and for plyfile, without an error. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet pyntcloud==0.3.1 pandas==2.3.3 numpy==2.3.5 laspy==2.7.0 plyfile==1.1.5
cat > look.py <<'PY'
import sys

import laspy
import numpy as np
from plyfile import PlyData
from pyntcloud import PyntCloud

las = laspy.create(point_format=0, file_version="1.2")
las.header.scales = [0.001] * 3
las.x, las.y, las.z = [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]
las.intensity = [100, 200, 250]
las.write("scan.las")

COLUMNS = ["x", "y", "z", "intensity"]
true = np.column_stack([las[column] for column in COLUMNS])
are_right = {}
for kind in ("uint8", "uint16"):
    cloud = PyntCloud.from_file("scan.las")
    cloud.points = cloud.points[COLUMNS].astype({"intensity": kind})
    cloud.to_file("scan.ply")
    vertices = PlyData.read("scan.ply")["vertex"]
    read = np.column_stack([vertices[column] for column in COLUMNS])
    again = PyntCloud.from_file("scan.ply").points[COLUMNS].to_numpy()
    are_right[kind] = np.isclose(read, true).all(axis=1).tolist()
    declared = vertices.ply_property("intensity")
    print(f"intensity as {kind}, declared as '{declared}': the second point is {true[1].tolist()}")
    print(f"  plyfile reads {read[1].tolist()}, pyntcloud {again[1].tolist()}")
sys.exit(0 if are_right == {"uint8": [True] * 3, "uint16": [True, False, False]} else 1)
PY
here/bin/python -W ignore look.py
echo "as described"
