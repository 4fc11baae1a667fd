"""One of the maker's two packages turns a servo; prints what it read as a line of JSON.

Usage: drive_dynamixel.py dynamixel_sdk|dynamixel_easy_sdk PORT BAUD. The first does what the
maker's examples do (read_write, sync_read_write, reboot, bulk_read_write), the second is its newer
interface.
"""

import json
import sys
import time

GOALS = (1500, 2600)
DEADLINE = 10.0


def drive_dynamixel_sdk(path, baud):
    from dynamixel_sdk import (
        COMM_SUCCESS,
        GroupBulkRead,
        GroupSyncRead,
        GroupSyncWrite,
        PacketHandler,
        PortHandler,
    )

    port, packets = PortHandler(path), PacketHandler(2.0)
    assert port.openPort()
    assert port.setBaudRate(baud)

    def good(*answer):
        *value, result, error = answer
        assert result == COMM_SUCCESS, packets.getTxRxResult(result)
        assert error == 0, packets.getRxPacketError(error)
        return value[0] if value else None

    # Ping, and what is refused
    found, result = packets.broadcastPing(port)
    assert result == COMM_SUCCESS
    model = good(*packets.ping(port, 1))
    good(*packets.write1ByteTxRx(port, 1, 64, 0))
    good(*packets.write1ByteTxRx(port, 1, 11, 3))
    good(*packets.write1ByteTxRx(port, 1, 64, 1))
    _, locked = packets.write1ByteTxRx(port, 1, 11, 3)
    _, limited = packets.write4ByteTxRx(port, 1, 116, 5000)
    absent = packets.ping(port, 9)[1]

    # Turn there and back
    good(*packets.write4ByteTxRx(port, 1, 108, 40))
    good(*packets.write4ByteTxRx(port, 1, 112, 400))
    reached = []
    for goal in GOALS:
        good(*packets.write4ByteTxRx(port, 1, 116, goal))
        until = time.monotonic() + DEADLINE
        position = -1
        while time.monotonic() < until and abs(position - goal) > 1:
            position = good(*packets.read4ByteTxRx(port, 1, 132))
        reached.append(position)

    # The same by groups
    writes, reads = GroupSyncWrite(port, packets, 116, 4), GroupSyncRead(port, packets, 132, 4)
    assert writes.addParam(1, list((2048).to_bytes(4, "little")))
    assert writes.txPacket() == COMM_SUCCESS
    assert reads.addParam(1)
    bulk = GroupBulkRead(port, packets)
    assert bulk.addParam(1, 144, 3)
    until = time.monotonic() + DEADLINE
    while time.monotonic() < until:
        assert reads.txRxPacket() == COMM_SUCCESS
        if abs(reads.getData(1, 132, 4) - 2048) <= 1:
            break
    reached.append(reads.getData(1, 132, 4))
    assert bulk.txRxPacket() == COMM_SUCCESS
    volts = bulk.getData(1, 144, 2) / 10
    good(*packets.write1ByteTxRx(port, 1, 64, 0))
    good(*packets.reboot(port, 1))
    port.closePort()
    return {
        "found": found,
        "model": model,
        "errors": [locked, limited, absent],
        "reached": reached,
        "volts": volts,
    }


def drive_dynamixel_easy_sdk(path, baud):
    from dynamixel_easy_sdk import Connector, OperatingMode

    connector = Connector(path, baud)
    motor = connector.createMotor(1)
    motor.disableTorque()
    motor.setOperatingMode(OperatingMode.POSITION)
    motor.enableTorque()
    reached = []
    for goal in GOALS:
        motor.setGoalPosition(goal)
        until = time.monotonic() + DEADLINE
        while time.monotonic() < until and abs(motor.getPresentPosition() - goal) > 1:
            pass
        reached.append(motor.getPresentPosition())
    motor.disableTorque()
    connector.closePort()
    return {"name": motor.model_name, "reached": reached}


def allow_for_a_busy_computer():
    """The SDK waits for twice this time [ms], and a little, for each answer."""
    from dynamixel_sdk import port_handler

    port_handler.LATENCY_TIMER = 250


client, path, baud = sys.argv[1:]
allow_for_a_busy_computer()
print("\n" + json.dumps(globals()[f"drive_{client}"](path, int(baud))), flush=True)
