#!/bin/sh
# mjcf-urdf-simple-converter 0.7.3 writes a hinge without a range, such as a driven wheel, as a revolute joint with
# the limits 0 and 0: it can't turn. URDF calls such a joint continuous, and its limits need no angles.
# Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet mjcf-urdf-simple-converter==0.7.3 mujoco==3.3.7 scipy==1.17.1
cat > robot.xml <<'XML'
<mujoco>
  <compiler angle="degree"/>
  <worldbody>
    <body name="base">
      <geom size="0.1" mass="1"/>
      <body name="wheel" pos="0 0.12 0">
        <joint name="wheel_spin" axis="0 1 0"/>
        <geom size="0.03" mass="0.1"/>
      </body>
      <body name="lidar" pos="0 0 0.2">
        <joint name="lidar_tilt" axis="0 1 0" range="-30 60"/>
        <geom size="0.03" mass="0.1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
XML
cat > look.py <<'PY'
import math
import sys
from xml.etree import ElementTree

import mujoco
from mjcf_urdf_simple_converter import convert

convert("robot.xml", "robot.urdf")
model = mujoco.MjModel.from_xml_path("robot.xml")
written = {joint.get("name"): joint for joint in ElementTree.parse("robot.urdf").iter("joint")}
found = {}
for name in ("wheel_spin", "lidar_tilt"):
    limit = written[name].find("limit")
    found[name] = written[name].get("type"), float(limit.get("lower")), float(limit.get("upper"))
    is_limited = bool(model.joint(name).limited[0])
    print(f"{name}: limited in MJCF {is_limited}; in URDF {found[name][0]}, {found[name][1]:.3f} to {found[name][2]:.3f}")
lower, upper = math.radians(-30), math.radians(60)
is_tilt_right = math.isclose(found["lidar_tilt"][1], lower) and math.isclose(found["lidar_tilt"][2], upper)
sys.exit(0 if is_tilt_right and found["wheel_spin"] == ("revolute", 0.0, 0.0) else 1)
PY
here/bin/python look.py
echo "as described"
