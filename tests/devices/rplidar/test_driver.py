"""The driver of the RPLIDAR against the emulated one, in virtual time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from virtual import VirtualClock
from virtual_room import TurningLidar

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.types import UNMEASURED, VALID
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.links.transport import Tapped
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.codec import Command, Health
from scan3d_twin.devices.rplidar.device import describe_rplidar
from scan3d_twin.devices.rplidar.driver import RplidarLidar, line_spec
from scan3d_twin.devices.rplidar.emulated_firmware import RplidarProfile
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator
from scan3d_twin.devices.rplidar.model import A1, C1, DENSE, EXPRESS, S2, STANDARD, STOP_PAUSE
from scan3d_twin.devices.rplidar.reading_filter import ReadingFilter

KINDS = [(A1, EXPRESS), (A1, STANDARD), (C1, DENSE), (C1, STANDARD), (S2, DENSE)]
SCAN, EXPRESS_SCAN = codec.encode_request(Command.SCAN), codec.encode_express_scan(1)
STATES = {
    "idle": [],
    "standard scan": [SCAN],
    "checked scan": [EXPRESS_SCAN],
    "request cut off": [codec.encode_conf_request(0x71, 1)[:4]],
    "garbage in its buffer": [b"\xff\x80\x00\xa5\xffgarbage"],
}


class Bench:
    """A lidar on a table: emulated, its line and its clock."""

    def __init__(self, model=C1, link=DENSE, profile=None, faults=None, seed=0, **turning):
        self.model, self.mode = model, model.modes[link]
        self.clock = VirtualClock()
        self.clock.time = 1.0
        self.source = TurningLidar(self.clock, model, self.mode, **turning)
        self.device = RplidarEmulator(self.source, model, profile)
        self.line = Line(self.device, faults or Faults(), seed)
        self.sent = []
        self.lidar = None

    def open_transport(self):
        wire = Wire(self.line, self.clock)
        return Tapped(wire, self.clock, lambda _, way, data: self.sent.append((way, data)))

    def connect(self, *modes):
        self.lidar = RplidarLidar(
            self.open_transport, self.clock, self.model, modes or (self.mode,)
        )
        return self.lidar

    def talk(self, requests):
        """Send ``requests`` as a client that has since died."""
        wire = Wire(self.line, self.clock, self.model.baud)
        for request in requests:
            wire.write(request)
            wire.read(0.0)
            self.clock.sleep(0.3)
        wire.close()

    def sent_requests(self):
        return [data for way, data in self.sent if way == ">"]

    def read(self, count):
        return [self.lidar.read_line(2.0) for _ in range(count)]

    def count_wrong(self, lines, beyond=0.5):
        """Return the number of readings, and of those that are ``beyond`` [mm] off the truth."""
        total = wrong = 0
        for line in lines:
            at = np.flatnonzero(line.codes == VALID)
            total += len(at)
            off = np.abs(np.round(1000 * line.ranges[at]) - self.source.truth(line, at))
            wrong += np.count_nonzero(off > beyond)
        return total, wrong

    def check(self, lines, share=0.99):
        """Assert that the lines are whole and each reading is what was measured."""
        for line in lines:
            at = np.flatnonzero(line.codes != UNMEASURED)
            readings = self.mode.sample_rate / self.model.turns
            assert len(at) >= share * readings
            expected = self.source.angle_at(line.stamp + line.beam_times[at])
            late = (line.elevations[at] - expected + math.pi) % math.tau - math.pi
            assert np.abs(late).max() / (math.tau * self.model.turns) < 0.002
        assert self.count_wrong(lines)[1] == 0


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize(("model", "link"), KINDS)
def test_connects_from_any_state(model, link, state):
    bench = Bench(model, link)
    bench.talk(STATES[state])
    before = bench.clock.now()
    lidar = bench.connect()
    assert bench.clock.now() - before <= 4.0
    assert lidar.info.device.model == model.model
    assert lidar.info.mode.reply == bench.mode.reply
    assert lidar.spec.n_beams == line_spec(model, bench.mode).n_beams
    bench.check(bench.read(3))
    assert lidar.bad <= 1


def test_an_old_a1_without_a_configuration_sends_express():
    bench = Bench(A1, EXPRESS, RplidarProfile(firmware=(1, 20)))
    bench.connect()
    bench.check(bench.read(2))
    assert not any(data[1:2] == b"\x84" for way, data in bench.sent if way == ">")


def test_it_takes_the_first_of_the_modes_that_the_lidar_has():
    bench = Bench(C1, STANDARD)
    express = A1.modes[EXPRESS]
    lidar = bench.connect(express, C1.modes[STANDARD])
    assert lidar.info.mode.name == "Standard"
    with pytest.raises(LinkError, match=r"cannot send Express; .* Standard .*--lidar-link"):
        Bench(C1, DENSE).connect(express)


def test_what_it_says_about_itself():
    lidar = Bench(C1, DENSE, RplidarProfile(health=Health(codec.WARNING, 1))).connect()
    text = describe_rplidar(lidar)
    assert text.startswith("RPLIDAR C1, firmware 1.01, hardware 18, serial number 7CF1994E")
    assert text.endswith("scan mode DenseBoost at 5000 Hz, health warning")


def test_another_model_is_named():
    bench = Bench(C1)
    bench.model = A1
    bench.device.firmware.model = C1
    with pytest.raises(LinkError, match="no RPLIDAR A1 answers at 115200 baud"):
        bench.connect(A1.modes[EXPRESS])
    wrong = Bench(S2, DENSE)
    wrong.line.device = RplidarEmulator(wrong.source, C1)
    wrong.model = S2
    wrong.line.device.firmware.model = type(C1)(
        **{name: getattr(C1, name) for name in C1.__slots__} | {"baud": S2.baud}
    )
    with pytest.raises(LinkError, match="no RPLIDAR S2 but RPLIDAR C1: use --lidar rplidar_c1"):
        wrong.connect()


def test_no_lidar_is_an_error_in_time_that_says_what_to_check():
    bench = Bench()
    bench.device.receive = lambda data, now: None
    with pytest.raises(LinkTimeoutError, match=r"no RPLIDAR C1 answers .* check its power"):
        bench.connect()
    assert bench.clock.now() < 4.0


@pytest.mark.parametrize(("model", "link"), [(A1, EXPRESS), (C1, DENSE)])
def test_a_protection_stop_is_ended_by_a_reset(model, link):
    bench = Bench(model, link, RplidarProfile(health=Health(codec.ERROR, 2)))
    bench.connect()
    assert bench.clock.now() < 7.0
    bench.check(bench.read(2))


def test_an_error_that_a_reset_does_not_mend_is_said():
    bench = Bench(profile=RplidarProfile(health=Health(codec.ERROR, 0x8002), is_broken=True))
    with pytest.raises(LinkError, match="error 0x8002: see that its head turns freely"):
        bench.connect()


@pytest.mark.parametrize(("model", "link"), [(A1, EXPRESS), (C1, DENSE), (S2, DENSE)])
def test_closing_stops_scan_and_motor(model, link):
    bench = Bench(model, link)
    lidar = bench.connect()
    assert bench.device.firmware.is_turning
    lidar.close()
    for _ in range(20):
        lidar.service()
    wire = Wire(bench.line, bench.clock, model.baud)
    bench.clock.sleep(0.2)
    wire.read(0.0)
    assert bench.device.firmware.mode is None
    assert not bench.device.firmware.is_turning
    assert wire.read(1.0) == b""


def test_after_stop_comes_a_pause_before_the_next_request():
    """The emulated one, as the real one, takes no request within 1 ms after STOP."""
    stop, start = codec.encode_request(Command.STOP), codec.encode_motor_rpm(600)
    bench = Bench(S2, DENSE, RplidarProfile(is_turning=False))
    bench.device.receive(stop + start, 1.0)
    assert not bench.device.firmware.is_turning
    bench.device.receive(start, 1.0 + STOP_PAUSE)
    assert bench.device.firmware.is_turning


def test_a_lidar_that_does_not_work_is_left_standing():
    bench = Bench(A1, EXPRESS, RplidarProfile(health=Health(codec.ERROR, 2), is_broken=True))
    with pytest.raises(LinkError):
        bench.connect()
    assert not bench.device.firmware.is_turning


@pytest.mark.parametrize("speed", [0.74, 0.97, 1.03, 1.3])
def test_the_speed_of_the_motor_is_measured(speed):
    bench = Bench(A1, EXPRESS, speed=speed)
    lidar = bench.connect()
    readings = bench.mode.sample_rate / (speed * A1.turns)
    for line in bench.read(4):
        assert np.count_nonzero(line.codes != UNMEASURED) == pytest.approx(readings, abs=2)
    assert lidar.spec.n_beams < 1.2 * readings


def test_a_clock_that_is_off_does_not_delay_the_stamps():
    bench = Bench(C1, DENSE, skew=0.001)
    bench.connect()
    for _ in range(100):
        bench.read(1)
    bench.check(bench.read(5), share=0.98)


def test_unplugged_it_connects_again_and_goes_on():
    bench = Bench()
    lidar = bench.connect()
    spec = lidar.spec
    bench.read(3)
    bench.line.plugged = False
    with pytest.raises(LinkTimeoutError, match="unplugged"):
        bench.read(50)
    bench.clock.sleep(3.0)
    bench.line.plugged = True
    bench.check([lidar.read_line(6.0)])
    assert lidar.stats.reconnects == 1
    assert lidar.spec is spec


def test_a_scan_that_ends_is_started_again():
    bench = Bench()
    lidar = bench.connect()
    bench.talk([codec.encode_request(Command.STOP)])
    with pytest.raises(LinkTimeoutError, match=r"0\.5 s"):
        [lidar.read_line(0.5) for _ in range(50)]
    bench.check([lidar.read_line(8.0)])
    assert lidar.stats.reconnects == 0


def test_that_it_fell_silent_is_told_apart_from_a_stream_without_a_good_scan():
    bench = Bench()
    lidar = bench.connect()
    bench.read(3)
    bench.talk([codec.encode_request(Command.STOP)])
    with pytest.raises(LinkTimeoutError, match="the lidar fell silent"):
        [lidar.read_line(1.5) for _ in range(50)]
    bench.check([lidar.read_line(8.0)])
    transmit = bench.device.transmit
    bench.device.transmit = lambda now: bytes(len(transmit(now)))
    with pytest.raises(LinkTimeoutError, match="no good scan arrives"):
        [lidar.read_line(1.5) for _ in range(50)]


@pytest.mark.parametrize(("model", "link"), KINDS)
def test_after_planning_lines_arrive_without_a_new_scan(model, link, caplog):
    bench = Bench(model, link)
    lidar = bench.connect()
    bench.read(3)
    sent, bad = len(bench.sent_requests()), lidar.stats.bad
    bench.clock.sleep(2.5)
    lines = bench.read(6)
    # What waited in the port is stale, and the rest of it was lost
    assert lines[0].stamp > bench.clock.now() - 1.5
    bench.check(lines)
    assert (len(bench.sent_requests()), lidar.stats.bad, caplog.messages) == (sent, bad, [])


@pytest.mark.parametrize(("model", "link"), KINDS)
def test_bytes_that_were_lost_do_not_delay_the_stamps(model, link):
    bench = Bench(model, link)
    bench.connect()
    bench.read(3)
    bench.clock.sleep(0.313)
    bench.line.receive(bench.clock.now(), model.baud)
    bench.check(bench.read(6), share=0.3)
    bench.check(bench.read(2))


def test_a_stalled_host_loses_nothing():
    bench = Bench()
    lidar = bench.connect()
    bench.read(3)
    bench.clock.sleep(0.4)
    bench.check(bench.read(5))
    assert lidar.bad == 0


@pytest.mark.parametrize(("model", "link"), [(A1, EXPRESS), (C1, DENSE), (S2, DENSE)])
def test_hardly_a_wrong_reading_passes_a_bad_line(model, link):
    count = 12 if model is S2 else 80
    bench = Bench(model, link, faults=Faults(drop=0.001, insert=0.001, flip=0.001))
    lidar = bench.connect()
    lines = bench.read(count)
    nominal = count * bench.mode.sample_rate / model.turns
    total, wrong = bench.count_wrong(lines, beyond=30)
    # 22 % of the capsules are damaged
    assert total > 0.75 * nominal
    assert 0.18 * nominal / 40 < lidar.bad < 0.3 * nominal / 32
    # 5e-6 of the readings of a long run; half of a damaged capsule would be 4e-4 of this one
    assert wrong <= 2
    assert bench.count_wrong(lines)[1] <= 1e-4 * total + 3


def spoil(line, at, distance):
    """Return ``line`` with the readings at some places ``at`` a distance [m]."""
    ranges, codes = line.ranges.copy(), line.codes.copy()
    ranges[at], codes[at] = distance, VALID
    return replace(line, ranges=ranges, codes=codes)


@pytest.fixture(scope="module")
def room_lines():
    """Six lines of a room."""
    bench = Bench()
    bench.connect()
    return bench.read(6)


def test_while_the_line_is_sound_lines_are_neither_delayed_nor_changed(room_lines):
    filtered = ReadingFilter(C1.noise)
    lines = [spoil(line, slice(200, 201), 7.0) for line in room_lines]
    for line in lines:
        assert filtered.take(line, 0) == [line]
    assert filtered.dropped == 0


@pytest.mark.parametrize("row", [slice(200, 201), slice(200, 203), slice(200, 220)])
def test_readings_that_only_one_line_has_are_left_out_while_it_is_noisy(room_lines, row):
    filtered, taken = ReadingFilter(C1.noise), []
    lines = [*room_lines[:3], spoil(room_lines[3], row, 7.0), *room_lines[4:]]
    for line in lines:
        taken += filtered.take(line, 1)
    assert len(taken) == 5
    assert (taken[3].codes[row] == UNMEASURED).all()
    assert np.isnan(taken[3].ranges[row]).all()
    assert filtered.dropped == row.stop - row.start
    for line, kept in zip(room_lines, [*taken[:3], taken[4]], strict=False):
        assert line in room_lines
        assert np.array_equal(kept.codes == VALID, lines[taken.index(kept)].codes == VALID)


def add_noise(line, noise, rng):
    """Return ``line`` with the ``noise`` of a lidar."""
    ranges = line.ranges + noise.at(line.ranges) * rng.standard_normal(len(line.ranges))
    return replace(line, ranges=ranges)


@pytest.mark.parametrize("bit", [32, 64])
def test_a_flip_of_a_low_bit_is_left_out_and_noise_is_not(room_lines, bit):
    rng, filtered, taken = np.random.default_rng(0), ReadingFilter(A1.noise), []
    lines = [add_noise(line, A1.noise, rng) for line in room_lines]
    # On the walls beside it, in 1.2 m
    at = [120, 136, 386]
    assert (lines[3].ranges[at] < 1.3).all()
    lines[3] = spoil(lines[3], at, lines[3].ranges[at] + np.array([1, -1, 1]) * bit / 1000)
    for line in lines:
        taken += filtered.take(line, 1)
    assert np.flatnonzero(taken[3].codes != lines[3].codes).tolist() == at
    assert filtered.dropped == len(at)


def test_a_reading_that_is_off_its_angle_is_left_out(room_lines):
    line = room_lines[1]
    elevations = line.elevations.copy()
    at = int(np.flatnonzero(line.codes == VALID)[300])
    elevations[at] += math.radians(0.5)
    filtered, taken = ReadingFilter(C1.noise), []
    lines = [room_lines[0], replace(line, elevations=elevations), *room_lines[2:4]]
    for each in lines:
        taken += filtered.take(each, 1)
    assert np.flatnonzero(taken[1].codes != line.codes).tolist() == [at]


def test_what_is_left_of_a_damaged_frame_is_left_out_too(room_lines):
    filtered, taken = ReadingFilter(C1.noise), []
    lines = [*room_lines[:3], spoil(room_lines[3], slice(200, 240, 3), 7.0), *room_lines[4:]]
    for line in lines:
        taken += filtered.take(line, 1)
    kept, there = np.flatnonzero(taken[3].codes == VALID), room_lines[3].codes == VALID
    assert not ((kept >= 207) & (kept < 233)).any()
    # Those beside it stay
    beside = [k for k in (*range(190, 200), *range(240, 250)) if there[k]]
    assert set(beside) <= set(kept)


def test_what_two_lines_have_stays_however_small(room_lines):
    filtered, taken = ReadingFilter(C1.noise), []
    for k, line in enumerate(room_lines):
        small = spoil(line, slice(200, 201), 0.5) if k in (2, 3) else line
        taken += filtered.take(small, 1)
    assert filtered.dropped == 0
    assert taken[2].ranges[200] == taken[3].ranges[200] == 0.5


def test_a_reading_in_a_place_of_another_time_is_left_out(room_lines):
    line = room_lines[1]
    times = line.beam_times.copy()
    at = np.flatnonzero(line.codes == VALID)[300]
    times[at] += 0.01
    filtered, taken = ReadingFilter(C1.noise), []
    for each in (room_lines[0], replace(line, beam_times=times), room_lines[2], room_lines[3]):
        taken += filtered.take(each, 1)
    assert np.flatnonzero(taken[1].codes != line.codes).tolist() == [at]
