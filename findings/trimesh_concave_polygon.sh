#!/bin/sh
# trimesh 5.2.0 reads a concave polygon of an OBJ, PLY or OFF file as a fan from its first corner,
# which fills what the polygon leaves out: an L of 0.20 m2 gets triangles of 0.36 m2 in all.
# Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet trimesh==5.2.0
cat > look.py <<'END'
import sys

import trimesh

CORNERS = ((0.2, 0.6), (0, 0.6), (0, 0), (0.6, 0), (0.6, 0.2), (0.2, 0.2))
open("ell.obj", "w").write(
    "".join(f"v {x} {y} 0\n" for x, y in CORNERS) + "f 1 2 3 4 5 6\n"
)
area = trimesh.load_mesh("ell.obj").area
print(f"trimesh {trimesh.__version__}: an L of 0.20 m2 has triangles of {area:.2f} m2")
sys.exit(0 if area > 0.21 else 1)
END
venv/bin/python look.py
echo "as described: concave polygons are read as fans"
