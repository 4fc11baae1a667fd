"""The emulated RPLIDAR, byte by byte."""

from dataclasses import replace

import numpy as np
import pytest
from virtual import VirtualClock
from virtual_room import TurningLidar

from scan3d_twin.devices.links.line_model import Line, Wire
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.capsules import decode_dense, decode_express
from scan3d_twin.devices.rplidar.codec import Command, ConfKey, Health
from scan3d_twin.devices.rplidar.emulated_firmware import SERIAL, RplidarProfile
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import A1, C1, DENSE, EXPRESS, S2, STANDARD, Motor
from scan3d_twin.devices.rplidar.nodes import decode_node

STOP, SCAN = codec.encode_request(Command.STOP), codec.encode_request(Command.SCAN)
RESET = codec.encode_request(Command.RESET)
NODES, CAPSULES = bytes.fromhex("A5 5A 05 00 00 40 81"), bytes.fromhex("A5 5A 54 00 00 40 82")


class Desk:
    """An emulated lidar and a client that has just opened its port."""

    def __init__(self, model=A1, profile=None, link=None):
        self.clock = VirtualClock()
        self.clock.time = 1.0
        mode = model.modes[link] if link else next(iter(model.modes.values()))
        self.device = RplidarEmulator(TurningLidar(self.clock, model, mode), model, profile)
        self.wire = Wire(Line(self.device), self.clock, model.baud)

    def ask(self, request, seconds=0.02):
        """Send a request; return all that comes within the time."""
        self.wire.write(request)
        return self.listen(seconds)

    def listen(self, seconds):
        until, data = self.clock.now() + seconds, b""
        while (left := until - self.clock.now()) > 1e-6:
            data += self.wire.read(left)
        return data


def conf(key, value, mode=None):
    """Return a request for an entry of the configuration and its reply."""
    payload = codec.encode_conf_reply(key, bytes.fromhex(value))
    reply = codec.encode_reply(codec.ReplyType.LIDAR_CONF, payload)
    return codec.encode_conf_request(key, mode), reply.hex()


@pytest.mark.parametrize(
    ("model", "request_", "reply"),
    [
        (A1, "A5 50", "A5 5A 14 00 00 00 04 18 1D 01 07" + SERIAL.hex()),
        (A1, "A5 52", "A5 5A 03 00 00 00 06 00 00 00"),
        (A1, "A5 59", "A5 5A 04 00 00 00 15 FC 01 FE 00"),
        (A1, "A5 FF 04 00 00 00 00 5E", "A5 5A 04 00 00 00 FF 00 00 00 00"),
        (C1, "A5 50", "A5 5A 14 00 00 00 04 41 01 01 12" + SERIAL.hex()),
        (S2, "A5 50", "A5 5A 14 00 00 00 04 71 01 01 12" + SERIAL.hex()),
        (A1, "A5 25", ""),
        (A1, "A5 F0 02 94 02 C1", ""),
        (A1, "A5 F0 02 94 02 C0", ""),
        (A1, "A5 77", ""),
        (A1, *conf(ConfKey.MODE_COUNT, "02 00")),
        (A1, *conf(ConfKey.TYPICAL_MODE, "01 00")),
        (A1, *conf(ConfKey.MODE_US_PER_SAMPLE, "00 FE 00 00", 1)),
        (A1, *conf(ConfKey.MODE_US_PER_SAMPLE, "00 FC 01 00", 0)),
        (A1, *conf(ConfKey.MODE_MAX_DISTANCE, "00 0C 00 00", 1)),
        (A1, *conf(ConfKey.MODE_REPLY_TYPE, "82", 1)),
        (A1, *conf(ConfKey.MODE_NAME, "45 78 70 72 65 73 73 00", 1)),
        (C1, *conf(ConfKey.MODE_REPLY_TYPE, "85", 1)),
        (C1, *conf(ConfKey.MODE_US_PER_SAMPLE, "00 C8 00 00", 1)),
        (S2, *conf(ConfKey.MODE_US_PER_SAMPLE, "40 1F 00 00", 1)),
        (S2, *conf(ConfKey.WANTED_SPEED, "58 02 00 00")),
    ],
)
def test_replies(model, request_, reply):
    request_ = request_ if isinstance(request_, bytes) else bytes.fromhex(request_)
    assert Desk(model).ask(request_) == bytes.fromhex(reply)


@pytest.mark.parametrize(
    "request_",
    [
        codec.encode_conf_request(ConfKey.MODE_NAME, 7),
        codec.encode_conf_request(0x7777),
        codec.encode_request(Command.GET_LIDAR_CONF, b"\x71"),
        codec.encode_express_scan(9),
    ],
)
def test_what_it_does_not_have_is_not_answered(request_):
    assert Desk().ask(request_) == b""


def test_an_old_firmware_does_not_answer_for_its_configuration():
    desk = Desk(profile=RplidarProfile(firmware=(1, 20)))
    assert desk.ask(codec.encode_conf_request(ConfKey.TYPICAL_MODE)) == b""
    assert desk.ask(codec.encode_express_scan(0)).startswith(CAPSULES)


def test_a_scan_is_nodes_of_whole_turns_at_the_pace_of_the_line():
    desk = Desk(link=STANDARD)
    data = desk.ask(SCAN, 1.0)
    assert data.startswith(NODES)
    body = data[len(NODES) :]
    nodes = [decode_node(body[at : at + 5]) for at in range(0, len(body) - 4, 5)]
    assert len(nodes) == pytest.approx(1e6 / 508, abs=5)
    firsts = [k for k, node in enumerate(nodes) if node.is_first]
    assert firsts[0] == 0
    assert all(abs(turn - 1e6 / 508 / 7.4) <= 1 for turn in np.diff(firsts[1:]))
    assert all(nodes[k].angle < 2 * 64 for k in firsts[1:])
    assert {node.quality for node in nodes} == {47}
    assert desk.ask(STOP, 0.002) != b""
    assert desk.listen(0.1) == b""


@pytest.mark.parametrize(
    ("model", "link", "decode", "step"),
    [(A1, EXPRESS, decode_express, 7.4 * 360 * 32 * 254e-6), (C1, DENSE, decode_dense, 28.8)],
)
def test_capsules_turn_on_by_their_samples_and_only_the_first_restarts(model, link, decode, step):
    desk = Desk(model, link=link)
    data = desk.ask(codec.encode_express_scan(1), model.spin_up + 0.5)[7:]
    capsules = [decode(data[at : at + 84]) for at in range(0, len(data) - 83, 84)]
    assert [capsule.is_first for capsule in capsules] == [True] + [False] * (len(capsules) - 1)
    turns = np.diff([capsule.start for capsule in capsules]) % (360 * 64)
    assert turns / 64 == pytest.approx(step, abs=1 / 32)
    assert len(capsules) > 55


def test_half_a_request_is_discarded_after_five_seconds():
    desk = Desk()
    info, health = (codec.encode_request(c) for c in (Command.GET_INFO, Command.GET_HEALTH))
    half = codec.encode_express_scan(1)[:2]
    desk.ask(half)
    desk.clock.sleep(4.9)
    # The lidar takes its first byte for the length of the payload
    assert desk.ask(info) == b""
    desk.clock.sleep(0.2)
    assert len(desk.ask(info)) == codec.DESCRIPTOR_LENGTH + codec.INFO_LENGTH
    # It counts from the beginning of each
    desk.clock.sleep(4.9)
    assert desk.ask(health[:1]) == b""
    desk.clock.sleep(0.2)
    assert len(desk.ask(health[1:])) == 10


def test_reset_says_what_booted_and_takes_its_time():
    desk = Desk()
    assert desk.ask(RESET, 0.4) == b""
    assert desk.ask(STOP + SCAN, 0.05) == b""
    text = desk.listen(0.2)
    assert 56 <= len(text) <= 63
    assert text.startswith(b"RP LIDAR System.")
    assert desk.ask(SCAN).startswith(NODES)
    desk = Desk(C1)
    assert desk.ask(RESET, 1.9) == desk.ask(SCAN, 0.05) == b""
    assert desk.listen(0.1) == b""


def test_after_an_error_it_scans_only_when_it_has_been_reset():
    desk = Desk(profile=RplidarProfile(health=Health(codec.ERROR, 0x8002)))
    assert desk.ask(codec.encode_request(Command.GET_HEALTH))[-3:] == bytes.fromhex("02 02 80")
    assert desk.ask(SCAN) == b""
    desk.ask(RESET, 1.0)
    assert desk.ask(SCAN).startswith(NODES)


def test_samples_come_when_the_motor_turns_steadily():
    desk = Desk(profile=RplidarProfile(is_turning=False))
    assert desk.ask(SCAN, 5.0) == NODES
    desk.wire.set_dtr(False)
    assert desk.listen(A1.spin_up - 0.01) == b""
    assert len(desk.listen(0.1)) > 100
    desk.wire.set_dtr(True)
    desk.listen(0.01)
    assert desk.listen(1.0) == b""
    assert not desk.device.firmware.is_turning


def test_an_s2_turns_at_the_speed_asked_for_and_a_c1_while_it_scans():
    desk = Desk(S2, RplidarProfile(is_turning=False))
    desk.ask(codec.encode_motor_rpm(600))
    assert desk.device.firmware.is_turning
    desk.ask(codec.encode_motor_rpm(0))
    assert not desk.device.firmware.is_turning
    desk = Desk(C1, RplidarProfile(is_turning=False))
    desk.wire.set_dtr(False)
    assert not desk.device.firmware.is_turning
    desk.ask(codec.encode_express_scan(1))
    assert desk.device.firmware.is_turning
    desk.ask(STOP)
    assert not desk.device.firmware.is_turning
    assert replace(C1).motor is Motor.SCAN


@pytest.mark.parametrize("model", [A1, S2])
def test_a_slower_scan_takes_fewer_of_the_readings(model):
    desk = Desk(model)
    desk.ask(SCAN, model.spin_up + 0.1)
    nodes = len(desk.listen(0.4)) / 5 / 0.4
    assert nodes == pytest.approx(model.modes[STANDARD].sample_rate, rel=0.02)


def test_a_scan_that_is_asked_for_while_another_runs_takes_its_place():
    desk = Desk()
    assert len(desk.ask(SCAN, 0.5)) > 1000
    data = desk.ask(codec.encode_express_scan(1), 0.5)
    _, found, capsules = data.partition(CAPSULES)
    assert found
    assert decode_express(capsules[:84]).is_first
