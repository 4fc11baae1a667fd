#!/bin/sh
# ICP of point-cloud-registration 1.0.5 leaves a good first guess if the clouds are turned against each other:
# its steps are computed in the target's frame, but applied in the source's, and these agree only without a
# turn. From 2 degrees beside the truth it reaches it if the truth is no turn, and ends far away if it is 90 or
# 180 degrees. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet point-cloud-registration==1.0.5
cat > look.py <<'PY'
import sys

import numpy as np
from point_cloud_registration import ICP

source = np.random.default_rng(1).uniform((-5, -5, -1.5), (5, 5, 1.5), (3000, 3))


def pose(degrees):
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def error(truth, found):
    off = np.linalg.inv(truth) @ found
    angle = np.degrees(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1)))
    return float(angle), float(np.linalg.norm(off[:3, 3]))


found = []
for degrees in (0, 90, 180):
    truth, guess = pose(degrees), pose(degrees + 2)
    icp = ICP(max_iter=50, max_dist=1.0)
    icp.set_target(source @ truth[:3, :3].T)
    found.append(error(truth, icp.align(source, init_T=guess)))
    angle, way = found[-1]
    print(f"turned by {degrees} degrees, guessed {degrees + 2}: ends {angle:.3f} degrees and {way:.3f} m off")
(angle, way), *turned = found
is_lost = all(angle > 5 or way > 1 for angle, way in turned)
sys.exit(0 if angle < 0.1 and way < 0.01 and is_lost else 1)
PY
here/bin/python look.py
echo "as described"
