#!/bin/sh
# Of an OBJ file with several objects or groups, MuJoCo 4.0.1 reads the vertices of all but the
# faces of the first alone: the others are neither drawn nor hit by rays, while their vertices count
# for the convex hull of contacts. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet mujoco-core==4.0.1
cat > look.py <<'END'
import sys

import mujoco
import numpy as np

FACES = ((1, 3, 2), (1, 2, 4), (2, 3, 4), (3, 1, 4))
lines = []
for number, x in enumerate((0, 2)):
    lines.append(f"o part{number}")
    lines += [f"v {x + a} {b} {c}" for a, b, c in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))]
    lines += ["f " + " ".join(str(k + 4 * number) for k in face) for face in FACES]
open("two.obj", "w").write("\n".join(lines))
model = mujoco.MjModel.from_xml_string(
    '<mujoco><asset><mesh file="two.obj"/></asset>'
    '<worldbody><geom type="mesh" mesh="two"/></worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
print(f"MuJoCo {mujoco.__version__}: {model.nmeshvert} vertices, {model.nmeshface} of 8 faces")
geom = np.zeros(1, np.int32)
for x in (0.2, 2.2):
    down = np.array([0.0, 0.0, -1.0])
    hit = mujoco.mj_ray(model, data, np.array([x, 0.2, 5.0]), down, None, 1, -1, geom, None)
    print(f"  a ray from above at x = {x}: {'miss' if hit < 0 else f'{hit:.2f} m'}")
sys.exit(0 if (model.nmeshvert, model.nmeshface) == (8, 4) else 1)
END
venv/bin/python look.py
echo "as described: only the first object of an OBJ file has faces"
