#!/bin/sh
# Protocol 2.0: inside a packet each FF FF FD is followed by a stuffed FD. dynamixel-sdk 4.1.0 makes the
# stuffed packet and throws it away (addStuffing rebinds its argument): the instruction goes out unstuffed,
# with a header in its middle. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet dynamixel-sdk==4.1.0
cd "$folder"
bin/python - <<'PY'
import sys

from dynamixel_sdk import PacketHandler


class Port:
    is_using = False

    def clearPort(self):
        pass

    def writePort(self, packet):
        self.sent = bytes(packet)
        return len(packet)


port = Port()
PacketHandler(2.0).write4ByteTxOnly(port, 1, 116, 0x00FDFFFF)
print("sent:", port.sent.hex(" "))
sys.exit(0 if b"\xff\xff\xfd\x00" in port.sent[4:] else 1)
PY
echo "as described: FF FF FD 00 is sent inside the packet, with no FD stuffed in"
