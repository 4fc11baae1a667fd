#!/bin/sh
# What dynamixel-sdk 4.1.0 makes of answers of protocol 2.0 that are not what was hoped for:
# - an answer with an error and no data: read1Byte and read2Byte return bytes of its CRC, read4Byte raises
#   IndexError;
# - an answer with stuffing, in which later FF FD FD follows another byte: it is taken for stuffing too, and
#   the data come back one byte short, the CRC's first byte behind them, as a success without error.
# Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder"
"$folder/bin/pip" install --quiet dynamixel-sdk==4.1.0
cd "$folder"
bin/python - <<'PY'
import sys

from dynamixel_sdk import PacketHandler

sdk = PacketHandler(2.0)


class Port:
    is_using = False

    def __init__(self, body):
        head = bytes.fromhex("FFFFFD0001") + (len(body) + 2).to_bytes(2, "little") + body
        self.data = head + sdk.updateCRC(0, head, len(head)).to_bytes(2, "little")

    def clearPort(self):
        pass

    def writePort(self, packet):
        return len(packet)

    def setPacketTimeout(self, length):
        pass

    def isPacketTimeout(self):
        return True

    def readPort(self, length):
        data, self.data = self.data[:length], self.data[length:]
        return list(data)


REFUSED = bytes.fromhex("5507")
byte = sdk.read1ByteTxRx(Port(REFUSED), 1, 132)
print("access error to a read of 1 byte: value, result, error =", byte)
try:
    sdk.read4ByteTxRx(Port(REFUSED), 1, 132)
    is_index_error = False
except IndexError as error:
    is_index_error = True
    print("to a read of 4 bytes: IndexError:", error)
sent = bytes.fromhex("FFFFFD00FFFDFD05")
stuffed = bytes.fromhex("5500") + sent.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
data, result, error = sdk.readRx(Port(stuffed), 1, len(sent))
print("sent", sent.hex(" "), "read", bytes(data).hex(" "), "result", result, "error", error)
is_shortened = bytes(data) != sent and (result, error) == (0, 0)
sys.exit(0 if byte[0] and is_index_error and is_shortened else 1)
PY
echo "as described"
