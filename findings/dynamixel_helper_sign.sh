#!/bin/sh
# dynamixel-helper 1.0.3 reads present velocity and position as unsigned: a servo that turns backwards at 10
# units reports 4294967286, a success, though the same class takes goal velocities from -(limit) to (limit), and
# both registers of the X series go below zero. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet dynamixel-helper==1.0.3 dynamixel-sdk==3.8.4
cd "$folder"
bin/python - <<'PY'
import sys

from dynamixel_helper.dxl_motor import DxlMotor
from dynamixel_sdk import PacketHandler

sdk = PacketHandler(2.0)
REGISTERS = {128: -10, 132: -1024}
"""Present velocity and position of an XL430 in extended position mode."""


class Port:
    is_using = False

    def setBaudRate(self, baud):
        return True

    def clearPort(self):
        pass

    def writePort(self, packet):
        value = REGISTERS[packet[8] | packet[9] << 8]
        body = bytes.fromhex("FFFFFD000108005500") + value.to_bytes(4, "little", signed=True)
        self.data = body + sdk.updateCRC(0, body, len(body)).to_bytes(2, "little")
        return len(packet)

    def setPacketTimeout(self, length):
        pass

    def isPacketTimeout(self):
        return True

    def readPort(self, length):
        data, self.data = self.data[:length], self.data[length:]
        return list(data)


ports = {"fake": {"handler": Port(), "baud rate": 57600}}
motor = DxlMotor(1, "turntable", "XL430-W250", ports, "auto", {2.0: sdk}, "quiet")
velocity, position = motor.get_present_velocity(), motor.get_present_position()
print(f"velocity -10 is read as {velocity[0]} (success {velocity[1]})")
print(f"position -1024 is read as {position[0]} (success {position[1]})")
sys.exit(0 if (velocity, position) == ((2**32 - 10, True), (2**32 - 1024, True)) else 1)
PY
echo "as described"
