#!/bin/sh
# rplidar-roboticia 0.9.5 reads the sixth bit of an express sample's angle correction as a sign, as the
# protocol's manual says; the lidar and Slamtec's SDK mean an unsigned number of 1/8 degrees. Corrections
# from 4 degrees on, which a real lidar always has, turn the points by up to 8 degrees or more. It also
# counts the samples of a capsule from 1: each point is one step late. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet rplidar-roboticia==0.9.5
cd "$folder"
bin/python - <<'EOF'
import sys

import rplidar

# A valid capsule: start 10 degrees, 32 samples of 1500 mm with the correction 7.25 degrees
frame = bytes.fromhex("A2508082" + 16 * "73177317AA")
capsule = rplidar.ExpressPacket.from_string(frame)
_, _, angle, distance = rplidar._process_express_scan(capsule, 26.0, 1)
print(f"first sample: {angle:.3f} degrees, {distance} mm; meant are 10 - 7.25 = 2.75 degrees")
sys.exit(0 if abs(angle - 2.75) > 10 and distance == 1500 else 1)
EOF
echo "as described: the correction of 58/8 degrees is read as -26/8, and the sample half a degree late"
