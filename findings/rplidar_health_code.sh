#!/bin/sh
# The error code of the RPLIDAR's health comes low byte first. rplidar-roboticia 0.9.5 and pyrplidar 0.1.2
# read it high byte first: 0x1234 becomes 0x3412. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet rplidar-roboticia==0.9.5 pyrplidar==0.1.2
cd "$folder"
bin/python - <<'EOF'
import sys

import rplidar
from pyrplidar_protocol import PyRPlidarHealth

REPLY = bytes.fromhex("01 34 12")


class Port:
    def __init__(self):
        self._data = bytes.fromhex("A55A0300000006") + REPLY

    def inWaiting(self):
        return len(self._data) if len(self._data) == 3 else 0

    def write(self, data):
        pass

    def read(self, count):
        data, self._data = self._data[:count], self._data[count:]
        return data


lidar = rplidar.RPLidar.__new__(rplidar.RPLidar)
lidar._serial, lidar.logger = Port(), rplidar.logging.getLogger()
codes = [lidar.get_health()[1], PyRPlidarHealth(REPLY).error_code]
print("0x1234 is read as", " and ".join(map(hex, codes)))
sys.exit(0 if codes == [0x3412, 0x3412] else 1)
EOF
echo "as described: the bytes of the code are swapped"
