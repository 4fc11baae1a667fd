"""The emulated lidar, byte by byte; replies are those of the SCIP 2.0 specification."""

from dataclasses import replace

import numpy as np
import pytest
from virtual import KnownLidar, VirtualClock

from scan3d_twin.devices.links.line_model import Line, Wire
from scan3d_twin.devices.urg import replies as scip_replies
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.devices.urg.replies import Splitter

MODERN = UrgProfile(firmware=(3, 3, 1))


class Desk:
    def __init__(self, profile=None):
        self.clock = VirtualClock()
        self.clock.time = 1.0
        self.device = UrgEmulator(KnownLidar(self.clock), profile)
        self.wire = Wire(Line(self.device), self.clock, self.device.firmware.baud)

    def ask(self, *requests, seconds=0.25):
        """Send the requests at once; return all that comes within the time."""
        self.wire.write(b"".join(requests))
        return self.listen(seconds)

    def listen(self, seconds):
        until, data = self.clock.now() + seconds, b""
        while (left := until - self.clock.now()) > 1e-6:
            data += self.wire.read(left)
        return data


@pytest.mark.parametrize(
    ("talk", "reply"),
    [
        ([b"BM\n"], b"BM\n00P\n\n"),
        ([b"BM\n", b"BM\n"], b"BM\n02R\n\n"),
        ([b"QT\n"], b"QT\n00P\n\n"),
        ([b"QT\r\n"], b"QT\n00P\n\n"),
        ([b"QT\r"], b"QT\n00P\n\n"),
        ([b"\n\n\r\nQT;as you like\n"], b"QT;as you like\n00P\n\n"),
        ([b"QT;12345678901234567\n"], b"QT;12345678901234567\n0Gg\n\n"),
        ([b"QT;?\n"], b"QT;?\n0Hh\n\n"),
        ([b"XY\n"], b"XY\n0Ee\n\n"),
        ([b"SCIP2.0\n"], b"SCIP2.0\n0Ee\n\n"),
        ([b"TM\n"], b"TM\n0Cc\n\n"),
        ([b"QT1\n"], b"QT1\n0Ff\n\n"),
        ([b"TM3\n"], b"TM3\n01Q\n\n"),
        ([b"TM0\n"], b"TM0\n00P\n\n"),
        ([b"TM0\n", b"TM0\n"], b"TM0\n02R\n\n"),
        ([b"TM2\n"], b"TM2\n03S\n\n"),
        ([b"TM1\n"], b"TM1\n04T\n\n"),
        ([b"TM0\n", b"QT\n"], b"QT\n0Ee\n\n"),
        ([b"TM0\n", b"TM2\n"], b"TM2\n00P\n\n"),
        ([b"SS115200\n"], b"SS115200\n00P\n\n"),
        ([b"SS019200\n"], b"SS019200\n03S\n\n"),
        ([b"SS01920x\n"], b"SS01920x\n01Q\n\n"),
        ([b"SS009600\n"], b"SS009600\n02R\n\n"),
        ([b"CR00\n"], b"CR00\n03S\n\n"),
        ([b"CR05\n"], b"CR05\n00P\n\n"),
        ([b"CR05\n", b"CR99\n"], b"CR99\n00P\n\n"),
        ([b"CR11\n"], b"CR11\n02R\n\n"),
        ([b"CR0x\n"], b"CR0x\n01Q\n\n"),
        ([b"HS0\n"], b"HS0\n0Ee\n\n"),
        ([b"DB01\n"], b"DB01\n0Ee\n\n"),
        ([b"RS\n"], b"RS\n00P\n\n"),
        ([b"GD0044072501\n"], b"GD0044072501\n10Q\n\n"),
        ([b"GD004407250x\n"], b"GD004407250x\n03S\n\n"),
        ([b"MD0044076901000\n"], b"MD0044076901000\n04T\n\n"),
        ([b"MD0045004401000\n"], b"MD0045004401000\n05U\n\n"),
        ([b"MD0044072501x00\n"], b"MD0044072501x00\n06V\n\n"),
        ([b"MD00440725010x0\n"], b"MD00440725010x0\n07W\n\n"),
        ([b"MD00x4072501000\n"], b"MD00x4072501000\n01Q\n\n"),
    ],
)
def test_replies(talk, reply):
    desk = Desk()
    for request in talk[:-1]:
        desk.ask(request)
    assert desk.ask(talk[-1]) == reply


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        *[(b"HS1", b"00P"), (b"HS0", b"03S"), (b"HS2", b"02R"), (b"HSx", b"01Q")],
        *[(b"DB01", b"00P"), (b"DB06", b"02R"), (b"DB0x", b"01Q"), (b"DB10", b"00P")],
    ],
)
def test_what_later_firmware_knows(request_, status):
    assert Desk(MODERN).ask(request_ + b"\n") == request_ + b"\n" + status + b"\n\n"


def test_several_requests_are_answered_in_order_but_the_same_one_only_once():
    data = Desk().ask(b"BM\n", b"CR00\n", b"BM\n")
    assert data == b"BM\n00P\n\nCR00\n03S\n\nBM\n0Bb\n\n"


def test_texts():
    desk = Desk()
    (block,) = Splitter().feed(desk.ask(b"PP\n"))
    parameters = scip_replies.decode_texts(scip_replies.decode_reply(block))
    assert parameters["ARES"] == "1024"
    assert [parameters[key] for key in ("AMIN", "AMAX", "AFRT")] == ["44", "725", "384"]
    (block,) = Splitter().feed(desk.ask(b"VV\n"))
    version = scip_replies.decode_texts(scip_replies.decode_reply(block))
    assert version["FIRM"] == "3.1.04(02/Aug./2007)"
    desk.ask(b"BM\n")
    before = desk.clock.now()
    (block,) = Splitter().feed(desk.ask(b"II\n"))
    state = scip_replies.decode_texts(scip_replies.decode_reply(block))
    assert (state["LASR"], state["STAT"]) == ("ON", "Sensor works well.")
    assert 0 <= int(state["TIME"], 16) - 1000 * before <= 100


def test_the_defects_of_a_version_can_be_had():
    data = Desk(UrgProfile(faulty_version=True)).ask(b"VV\n")
    assert data.endswith(b"\nSERI:H0000001;?\nI\n\n")


@pytest.mark.parametrize("width", [3, 2])
def test_a_stream_is_counted_down_and_the_laser_goes_off(width):
    desk = Desk()
    name = b"MD" if width == 3 else b"MS"
    data = desk.ask(name + b"0044072501002\n", seconds=1.0)
    first, *scans = Splitter().feed(data)
    assert first == (name + b"0044072501002", b"00P")
    assert [scan[:2] for scan in scans] == [
        (name + b"0044072501001", b"99b"),
        (name + b"0044072501000", b"99b"),
    ]
    assert not desk.device.firmware.laser
    request = ScanRequest(name.decode(), 44, 725)
    for block in scans:
        scan = scip_replies.decode_scan(scip_replies.decode_reply(block), request)
        turn = KnownLidar.turn_at(scan.time_ms / 1000)
        assert scan.time_ms == int(1000 * KnownLidar.stamp(turn) + 1e-6)
        assert np.array_equal(scan.values, KnownLidar.values(turn))


def test_turns_are_left_out_as_asked():
    desk = Desk()
    splitter = Splitter()
    blocks = splitter.feed(desk.ask(b"MD0384038401300;tag\n", seconds=3.0))[1:]
    assert {block[0] for block in blocks} == {b"MD0384038401300;tag"}
    request = ScanRequest("MD", 384, 384)
    scans = [scip_replies.decode_scan(scip_replies.decode_reply(b), request) for b in blocks]
    assert set(np.diff([scan.time_ms for scan in scans])) <= {399, 400, 401}


def test_turns_the_lidar_behind_leaves_out_count_as_left_out():
    desk = Desk()

    class EverySecondTurn(KnownLidar):
        def read_line(self, timeout):
            line = super().read_line(timeout)
            return line if self.next % 2 else self.read_line(timeout)

    half = EverySecondTurn(desk.clock)
    half.spec = replace(half.spec, line_period=0.2)
    desk.device = UrgEmulator(half)
    desk.wire = Wire(Line(desk.device), desk.clock)
    blocks = Splitter().feed(desk.ask(b"MD0384038401100\n", seconds=4.2))
    assert len(blocks) - 1 == pytest.approx(20, abs=1)


@pytest.mark.parametrize(("cluster", "count"), [(1, 6), (2, 3), (4, 2), (99, 1)])
def test_a_cluster_is_its_shortest_valid_distance(cluster, count):
    desk = Desk()
    values = np.full(682, 3000)
    values[:6] = 7, 900, 800, 0, 6, 5
    desk.device._lidar.values = lambda turn: values
    desk.ask(b"BM\n")
    data = desk.ask(f"GD00440049{cluster:02d}\n".encode())
    (block,) = Splitter().feed(data)
    request = ScanRequest("GD", 44, 49, cluster)
    scan = scip_replies.decode_scan(scip_replies.decode_reply(block), request)
    expected = {1: [7, 900, 800, 0, 6, 5], 2: [900, 800, 6], 4: [800, 6], 99: [800]}[cluster]
    assert len(scan.values) == count
    assert scan.values == expected


def test_gd_gives_the_latest_scan():
    desk = Desk()
    desk.ask(b"BM\n")
    (block,) = Splitter().feed(desk.ask(b"GD0044072501\n", seconds=0.12))
    scan = scip_replies.decode_scan(scip_replies.decode_reply(block), ScanRequest("GD", 44, 725))
    assert 100 <= 1000 * desk.clock.now() - scan.time_ms <= 330


def test_the_whole_circle_may_be_asked_for_though_its_ends_are_blind():
    """Steps 0 to 768, as in the examples of the specification; some clients always ask so."""
    desk = Desk()
    desk.ask(b"BM\n")
    (block,) = Splitter().feed(desk.ask(b"GD0000076801\n", seconds=0.3))
    request = ScanRequest("GD", 0, 768)
    scan = scip_replies.decode_scan(scip_replies.decode_reply(block), request)
    measured = KnownLidar.values(KnownLidar.turn_at(scan.time_ms / 1000)).tolist()
    assert scan.values == [0] * 44 + measured + [0] * 43
    old = Desk(UrgProfile(scip1=True))
    (block,) = Splitter().feed(old.ask(b"G00076801\n", seconds=0.3))
    _, status, lines = scip_replies.decode_old_reply(block)
    assert status == "0"
    assert len(scip_replies.decode_old_scan(lines)) == 769


def test_a_stream_cannot_be_started_twice_and_qt_ends_it():
    desk = Desk()
    desk.ask(b"MD0384038401000\n")
    assert b"MD0384038401000\n0Bb\n\n" in desk.ask(b"MD0384038401000\n")
    assert b"QT\n00P\n\n" in desk.ask(b"QT\n")
    assert desk.listen(0.5) == b""
    assert not desk.device.firmware.laser


def test_a_malfunction_halts_the_stream_and_it_goes_on():
    desk = Desk(MODERN)
    desk.ask(b"MD0384038401000\n")
    assert desk.ask(b"DB03\n").endswith(b"DB03\n00P\n\nMD0384038401000\n23U\n\n")
    assert desk.listen(0.5) == b""
    assert b"DB10\n00P\n\nMD0384038401000\n98a\n\nMD" in desk.ask(b"DB10\n", seconds=0.5)


def test_the_time_mode_tells_the_timer():
    desk = Desk(UrgProfile(timer_ms=(1 << 24) - 1500))
    desk.ask(b"TM0\n")
    data = desk.ask(b"TM1\n", seconds=0.2)
    (block,) = Splitter().feed(data)
    time_ms = scip_replies.decode_time(scip_replies.decode_reply(block))
    elapsed = (time_ms + 1500) % (1 << 24)
    assert 1250 <= elapsed <= 1450


def test_requests_are_answered_on_the_tick_of_the_capture():
    # Firmware 3.1.04 answered at 10.8, 110.8, 211.0, 310.7, 409.8, ... 808.8 ms.
    desk = Desk()
    times = []
    for _ in range(8):
        desk.wire.write(b"QT\n")
        assert desk.wire.read(1.0) == b"QT\n00P\n\n"
        times.append(desk.clock.now())
    assert np.allclose(np.diff(times), 0.0998, atol=0.003)


def test_without_a_tick_it_answers_at_once():
    desk = Desk(UrgProfile(tick=0.0))
    desk.wire.write(b"QT\n")
    assert desk.wire.read(0.0) == b"QT\n00P\n\n"


def test_a_new_bit_rate_holds_after_the_reply():
    desk = Desk(UrgProfile(usb=False, baud=19200))
    assert desk.ask(b"SS115200\n") == b"SS115200\n00P\n\n"
    assert desk.ask(b"QT\n") != b"QT\n00P\n\n"
    desk.wire.set_baud(115200)
    desk.listen(0.3)
    assert desk.ask(b"\nQT\n").endswith(b"QT\n00P\n\n")
    assert desk.ask(b"RS\n") == b"RS\n00P\n\n"
    desk.wire.set_baud(19200)
    assert desk.ask(b"QT\n") == b"QT\n00P\n\n"


def test_over_usb_bit_rates_do_not_matter():
    desk = Desk()
    desk.wire.set_baud(750000)
    assert desk.ask(b"SS250000\n") == b"SS250000\n00P\n\n"
    assert desk.ask(b"QT\n") == b"QT\n00P\n\n"


@pytest.mark.parametrize(
    ("baud", "request_", "hertz"),
    [
        (19200, b"MD0044072501000\n", 10 / 12),
        (57600, b"MD0044072501000\n", 2.5),
        (115200, b"MD0044072501000\n", 5),
        (115200, b"MS0044072501000\n", 5),
        (115200, b"MD0044072502000\n", 10),
        (115200, b"MD0206056201000\n", 10),
        (250000, b"MD0044072501000\n", 10),
    ],
)
def test_what_does_not_fit_the_line_is_dropped_as_whole_scans(baud, request_, hertz):
    desk = Desk(UrgProfile(usb=False, baud=baud))
    splitter = Splitter()
    blocks = splitter.feed(desk.ask(request_, seconds=12.4))
    assert len(blocks) - 1 == pytest.approx(12 * hertz, abs=2)
    request = ScanRequest(
        request_[:2].decode(), int(request_[2:6]), int(request_[6:10]), int(request_[10:12])
    )
    for block in blocks[1:]:
        scip_replies.decode_scan(scip_replies.decode_reply(block), request)
    assert (desk.device.dropped > 0) == (hertz < 10)


@pytest.mark.parametrize("request_", [b"ME0044072501000\n", b"HD0044072501\n"])
def test_what_later_lidars_know_may_silence_it(request_):
    assert Desk().ask(request_) == request_ + b"0Ee\n\n"
    desk = Desk(UrgProfile(mute_on_multiecho=True))
    assert desk.ask(request_) == b""
    assert desk.ask(b"QT\n") == b""
    desk.device.power_up(desk.clock.now())
    assert desk.ask(b"QT\n", seconds=2.9) == b""
    desk.listen(0.2)
    assert desk.ask(b"QT\n") == b"QT\n00P\n\n"


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        (b"QT\n", b"QT\nE\n\n"),
        (b"VV\n", b"VV\nE\n\n"),
        (b"L0\n", b"L0\n0\n\n"),
        (b"S1152000000000\n", b"S1152000000000\n0\n\n"),
        (b"S9999990000000\n", b"S9999990000000\nE\n\n"),
        (b"G04476901\n", b"G04476901\nE\n\n"),
        (b"SCIP2.0\n", b"SCIP2.0\n0\n\n"),
    ],
)
def test_replies_of_scip_1_1(request_, reply):
    assert Desk(UrgProfile(scip1=True)).ask(request_) == reply


def test_the_version_in_scip_1_1_has_no_sums():
    data = Desk(UrgProfile(scip1=True)).ask(b"V\n")
    assert data.startswith(b"V\n0\nVEND:Hokuyo Automatic Co.,Ltd.\n")


def test_a_scan_in_scip_1_1():
    desk = Desk(UrgProfile(scip1=True))
    assert desk.device.firmware.laser
    (block,) = Splitter().feed(desk.ask(b"G04472501\n"))
    echo, status, lines = scip_replies.decode_old_reply(block)
    assert (echo, status) == ("G04472501", "0")
    values = scip_replies.decode_old_scan(lines)
    assert any(np.array_equal(values, KnownLidar.values(turn)) for turn in range(20))
    desk.ask(b"L0\n")
    assert desk.ask(b"G04472501\n") == b"G04472501\nE\n\n"


def test_the_switch_to_scip_2_0_puts_the_laser_out():
    desk = Desk(UrgProfile(scip1=True))
    desk.ask(b"SCIP2.0\n")
    assert desk.ask(b"QT\n") == b"QT\n00P\n\n"
    assert not desk.device.firmware.laser


def test_any_garbage_is_answered_in_blocks():
    desk = Desk(UrgProfile(tick=0.0))
    rng = np.random.default_rng(1)
    splitter, blocks = Splitter(), []
    for _ in range(300):
        data = rng.choice([*b"QTVMDGSPICR0123456789;\n\n\r", 200, 0], 60).astype(np.uint8)
        blocks += splitter.feed(desk.ask(data.tobytes(), seconds=0.01))
    assert len(blocks) > 1000
    for block in blocks:
        scip_replies.decode_reply(block)
    assert len(desk.device._request) <= 64


def test_the_same_bytes_at_the_same_times_give_the_same_bytes():
    def talk():
        desk = Desk(UrgProfile(usb=False, baud=115200))
        return desk.ask(b"MD0044072501000\n", b"VV\n", seconds=2.0)

    assert talk() == talk()
