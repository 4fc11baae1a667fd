"""The lidar's driver against the emulated lidar, in virtual time."""

import numpy as np
import pytest
from virtual import KnownLidar, VirtualClock, values_of

from scan3d_twin.core.errors import ConfigError, LinkError, LinkTimeoutError
from scan3d_twin.core.types import LOST, UNMEASURED, VALID
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.links.transport import Tapped
from scan3d_twin.devices.urg.codec import BAUDS
from scan3d_twin.devices.urg.driver import UrgLidar
from scan3d_twin.devices.urg.emulated_quirks import UrgProfile
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.devices.urg.model import LINKS, REVOLUTION, ScanMode

pytestmark = pytest.mark.slow

SERIAL = UrgProfile(usb=False, baud=115200)


class Bench:
    """A lidar on a table: emulated, its line and its clock."""

    def __init__(self, profile=None, faults=None, seed=0):
        self.clock = VirtualClock()
        self.device = UrgEmulator(KnownLidar(self.clock), profile)
        self.line = Line(self.device, faults or Faults(), seed)
        self.sent = []
        self.lidar = None

    def open_transport(self):
        wire = Wire(self.line, self.clock)
        return Tapped(wire, self.clock, lambda _, way, data: self.sent.append((way, data)))

    def connect(self, mode="usb", **options):
        mode = LINKS[mode] if isinstance(mode, str) else mode
        self.lidar = UrgLidar(self.open_transport, self.clock, mode, **options)
        return self.lidar

    def talk(self, data, seconds=0.3, baud=None):
        """Send ``data`` as a client that has since died."""
        wire = Wire(self.line, self.clock, baud or self.device.baud)
        for request in data:
            wire.write(request)
            wire.read(0.0)
            self.clock.sleep(seconds)
        wire.close()

    def requests(self):
        return [data for way, data in self.sent if way == ">"]

    def check(self, lines, first=44, last=725, garbled=False):
        """Assert that each line is the one that was measured at its time.

        Where a line may be ``garbled``, readings may be lost, but none may be wrong.
        """
        for line in lines:
            turn = KnownLidar.turn_at(line.stamp)
            arrived = line.codes != LOST
            assert garbled or arrived.all()
            measured = KnownLidar.values(turn)[first - 44 : last - 43]
            assert np.array_equal(values_of(line)[arrived], measured[arrived])


def read(lidar, count, timeout=1.0):
    return [lidar.read_line(timeout) for _ in range(count)]


STATES = {
    "silent": [],
    "streaming": [b"MD0044072501000\n"],
    "streaming, request cut off": [b"MD0044072501000\n", b"GD00"],
    "time mode": [b"TM0\n"],
    "laser on": [b"BM\n"],
    "garbage in its buffer": [b"\xff\x80\x00garbage"],
}


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("baud", BAUDS)
def test_connects_from_any_state(baud, state):
    bench = Bench(UrgProfile(usb=False, baud=baud))
    bench.talk(STATES[state])
    before = bench.clock.now()
    lidar = bench.connect()
    took = bench.clock.now() - before
    assert took <= (3.2 if state.startswith("streaming") and baud < 50000 else 2.2)
    assert lidar.info.baud == baud
    bench.check(read(lidar, 3))


@pytest.mark.parametrize("baud", [19200, 115200])
@pytest.mark.parametrize("talk", [[], [b"G04472501\n"], [b"L0\n"], [b"V\n", b"nonsense"]])
def test_connects_to_a_sensor_that_speaks_scip_1_1(baud, talk):
    bench = Bench(UrgProfile(usb=False, baud=baud, scip1=True))
    bench.talk(talk)
    before = bench.clock.now()
    lidar = bench.connect()
    assert bench.clock.now() - before <= 2.2
    bench.check(read(lidar, 3))


@pytest.mark.parametrize("baud", [19200, 38400, 750000])
def test_connects_where_a_wrong_bit_rate_is_silence(baud):
    bench = Bench(UrgProfile(usb=False, baud=baud), Faults(silent=True))
    bench.check(read(bench.connect(), 3))
    assert bench.clock.now() <= 2.7


@pytest.mark.parametrize("scip1", [False, True])
def test_connects_over_usb_from_any_state(scip1):
    for state, talk in STATES.items():
        bench = Bench(UrgProfile(scip1=scip1))
        bench.talk(talk)
        before = bench.clock.now()
        bench.check(read(bench.connect(), 3))
        assert bench.clock.now() - before <= 2.2, state


def test_connects_while_the_sensor_is_still_starting():
    bench = Bench(UrgProfile(usb=False, baud=19200, boot=1.5))
    bench.device.power_up(0.0)
    bench.connect()
    assert 1.5 < bench.clock.now() <= 6.0


@pytest.mark.parametrize(
    "junk", [b"\x00\xff" * 40, b"99b\n\n\nQT\n", b"QT\n00P\n", b"boot\r\n" * 9]
)
def test_junk_in_the_port_does_not_matter(junk):
    bench = Bench(SERIAL, Faults(junk=junk))
    bench.check(read(bench.connect("115200"), 3), 206, 562)


def test_no_sensor_is_an_error_in_time_that_says_what_to_check():
    bench = Bench(UrgProfile(boot=1e9))
    bench.device.power_up(0.0)
    with pytest.raises(LinkError, match="power"):
        bench.connect()
    assert bench.clock.now() <= 6.0


def test_a_sensor_that_goes_silent_while_connecting_is_an_error_in_time():
    bench = Bench(SERIAL)
    original = bench.device.firmware.answer
    bench.device.firmware.answer = lambda line, now, seen: (
        original(line, now, seen) if line == b"QT" else b""
    )
    with pytest.raises(LinkTimeoutError, match="PP"):
        bench.connect()
    assert bench.clock.now() <= 6.0


@pytest.mark.parametrize(
    ("link", "profile"),
    [("usb", UrgProfile()), ("115200", SERIAL), ("115200-full", SERIAL), ("usb", SERIAL)],
)
def test_lines_are_what_was_measured_when_it_was_measured(link, profile):
    mode = LINKS[link]
    bench = Bench(profile)
    lidar = bench.connect(link)
    lines = read(lidar, 60)
    bench.check(lines, mode.first_step, mode.last_step)
    stamps = np.array([line.stamp for line in lines])
    assert np.abs(stamps - KnownLidar.stamp(KnownLidar.turn_at(stamps[0])) - 0.0).min() < 0.01
    truth = np.array([KnownLidar.stamp(KnownLidar.turn_at(stamp)) for stamp in stamps])
    assert np.abs(stamps - truth).max() < 0.006
    assert np.allclose(np.diff(truth), mode.line_period)
    assert lidar.stats.bad == 0


def test_two_characters_are_chosen_where_three_do_not_fit():
    bench = Bench(SERIAL)
    mode = ScanMode(384 - 265, 384 + 265, 1)
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock))
    lidar = bench.connect(mode)
    assert (lidar.request.command, bench.device.firmware.baud) == ("MS", 115200)
    lines = read(lidar, 20)
    bench.check(lines, mode.first_step, mode.last_step)
    assert np.allclose(np.diff([line.stamp for line in lines]), REVOLUTION, atol=0.006)


def test_a_cluster_reports_the_shortest_of_its_steps():
    bench = Bench(SERIAL)
    lidar = bench.connect(ScanMode(44, 725, 1), cluster=2)
    assert lidar.spec.n_beams == 341
    assert lidar.spec.elevations[0] == pytest.approx(np.radians((44.5 - 384) * 360 / 1024))
    line = read(lidar, 1)[0]
    pairs = KnownLidar.values(KnownLidar.turn_at(line.stamp)).reshape(-1, 2)
    shortest = np.where(pairs < 20, 9999, pairs).min(axis=1)
    shortest = np.where(shortest == 9999, pairs[:, 0], shortest)
    assert np.array_equal(values_of(line), shortest)


@pytest.mark.parametrize(
    ("best", "command", "cluster"),
    [(250000, "MD", 1), (115200, "MD", 2), (57600, "MS", 3), (38400, "MS", 4)],
)
def test_as_few_steps_are_merged_as_the_rate_needs(best, command, cluster):
    bench = Bench(UrgProfile(usb=False, baud=19200))
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock), best=best)
    lidar = bench.connect(ScanMode(44, 725, 1))
    assert (lidar.request.command, lidar.request.cluster) == (command, cluster)
    assert lidar.spec.n_beams == -(-682 // cluster)
    lines = read(lidar, 10)
    assert np.allclose(np.diff([line.stamp for line in lines]), REVOLUTION, atol=0.006)
    bench.line.plugged = False
    bench.clock.sleep(0.5)
    bench.line.plugged = True
    assert len(read(lidar, 2, timeout=6.0)[-1].ranges) == lidar.spec.n_beams


def test_what_no_merging_makes_fit_is_refused_with_the_numbers():
    bench = Bench(UrgProfile(usb=False, baud=19200))
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock), best=19200)
    words = "682 steps, 4 merged into one, take 198 ms at 19200 baud, but a line lasts 100 ms"
    with pytest.raises(LinkError, match=words):
        bench.connect(ScanMode(44, 725, 1))


@pytest.mark.parametrize(("best", "steps"), [(750000, 682), (115200, 363), (57600, 177)])
def test_without_a_mode_the_window_is_what_the_port_carries(best, steps):
    bench = Bench(UrgProfile(usb=False, baud=19200))
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock), best=best)
    lidar = bench.connect(None)
    assert lidar.spec.n_beams == pytest.approx(steps, abs=3)
    lines = read(lidar, 10)
    bench.check(lines, lidar.request.first, lidar.request.last)
    assert np.allclose(np.diff([line.stamp for line in lines]), REVOLUTION, atol=0.006)


@pytest.mark.parametrize("seed", range(8))
def test_connects_over_a_bad_line(seed):
    bench = Bench(UrgProfile(usb=False, baud=19200, scip1=True), Faults(5e-4, 5e-4, 5e-4), seed)
    lidar = bench.connect("115200")
    assert bench.clock.now() <= 6.0
    bench.check(read(lidar, 2, timeout=4.0), 206, 562, garbled=True)


class Limited:
    """A port that does ``best`` baud at most; above that it refuses, or nothing arrives."""

    def __init__(self, wire, refuse=True, best=115200):
        self.wire, self.refuse, self.best = wire, refuse, best
        self.read, self.write, self.close = wire.read, wire.write, wire.close
        self.discard_input = wire.discard_input

    def set_baud(self, baud):
        if baud > self.best and self.refuse:
            raise LinkError(f"cannot do {baud} baud")
        self.wire.set_baud(baud if baud <= self.best else 1200)


def test_what_does_not_fit_is_refused_with_the_numbers():
    bench = Bench(SERIAL)
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock))
    with pytest.raises(LinkError, match=r"682 steps take 125 ms at 115200 baud.* 100 ms"):
        bench.connect("usb", cluster=1)
    assert not bench.device.firmware.laser
    assert bench.device.firmware.baud == 115200


def test_a_port_that_promises_too_much_is_an_error_that_says_the_cure():
    bench = Bench(SERIAL)
    bench.open_transport = lambda: Limited(Wire(bench.line, bench.clock), refuse=False)
    with pytest.raises(LinkError, match=r"250000 baud .* power the lidar off and on"):
        bench.connect("usb")
    assert bench.clock.now() <= 6.0


def test_a_sensor_that_says_yes_and_stays_where_it_was_is_found_there():
    bench = Bench(SERIAL)
    answer = bench.device.firmware.answer
    bench.device.firmware.answer = lambda line, now, seen: (
        b"SS250000\n00P\n\n" if line == b"SS250000" else answer(line, now, seen)
    )
    bench.check(read(bench.connect("usb"), 3))
    assert bench.device.firmware.baud == 500000
    assert bench.clock.now() <= 6.0


def test_good_and_bad_scans_are_counted():
    bench = Bench()
    lidar = bench.connect()
    before, good = read(lidar, 3)[-1], lidar.stats.good
    bench.line.faults = Faults(drop=7e-3)
    lines = read(lidar, 8, timeout=20.0)
    assert lidar.stats.good + lidar.stats.garbled == good + 8
    turns = KnownLidar.turn_at(lines[-1].stamp) - KnownLidar.turn_at(before.stamp)
    assert lidar.stats.bad == turns - 8 > 0
    assert lidar.bad == lidar.stats.bad + lidar.stats.garbled
    # Each row of 64 characters holds 21.3 readings
    lost = sum(int((line.codes == LOST).sum()) for line in lines)
    assert 20 < lost / lidar.stats.lost_rows < 24


def test_a_sensor_that_does_not_know_a_bit_rate_is_asked_for_the_next():
    bench = Bench(SERIAL)
    answer = bench.device.firmware.answer
    bench.device.firmware.answer = lambda line, now, seen: (
        b"SS250000\n04T\n\n" if line == b"SS250000" else answer(line, now, seen)
    )
    bench.check(read(bench.connect("usb"), 3))
    assert bench.device.firmware.baud == 500000


@pytest.mark.parametrize(
    "mode",
    [ScanMode(43, 725, 1), ScanMode(44, 726, 1), ScanMode(400, 399, 1), ScanMode(44, 50, 11)],
)
def test_modes_there_are_not(mode):
    with pytest.raises(ConfigError, match="must be"):
        Bench().connect(mode)


def test_a_cluster_there_is_not():
    with pytest.raises(ConfigError, match="cluster"):
        Bench().connect("usb", cluster=0)


def test_another_lidar_is_refused():
    bench = Bench()
    answer = bench.device.firmware.answer
    bench.device.firmware.answer = lambda *a: answer(*a).replace(b"ARES:1024;\\", b"ARES:1440;^")
    with pytest.raises(LinkError, match=r"not an URG-04LX: ARES is 1440, not 1024"):
        bench.connect()


def test_a_faulty_version_is_tolerated_and_asked_for_once():
    bench = Bench(UrgProfile(faulty_version=True))
    lidar = bench.connect()
    assert lidar.info.version["FIRM"].startswith("3.1.04")
    assert "SERI" not in lidar.info.version
    assert lidar.info.state["STAT"] == "Sensor works well."
    bench.line.plugged = False
    for _ in range(20):
        bench.clock.sleep(0.05)
        lidar.service()
    bench.line.plugged = True
    read(lidar, 3, timeout=5.0)
    assert bench.requests().count(b"VV\n") == 1


def test_nothing_is_sent_that_silences_the_sensor():
    bench = Bench(UrgProfile(usb=False, baud=750000, scip1=True, mute_on_multiecho=True))
    bench.connect()
    bench.lidar.close()
    known = {b"QT", b"PP", b"VV", b"II", b"TM", b"SS", b"MD", b"SC"}
    lines = b"".join(bench.requests()).split()
    assert {line[:2] for line in lines} <= known
    assert not bench.device.firmware.mute


def test_every_request_is_one_write():
    bench = Bench(SERIAL)
    bench.connect("115200")
    assert all(data.endswith(b"\n") for data in bench.requests())


@pytest.mark.parametrize("baud", [19200, 115200, 500000])
def test_closing_stops_the_laser_and_leaves_a_usual_bit_rate(baud):
    bench = Bench(UrgProfile(usb=False, baud=baud))
    lidar = bench.connect("usb")
    read(lidar, 3)
    before = bench.clock.now()
    lidar.close()
    assert bench.clock.now() - before < 0.6
    bench.clock.sleep(0.2)
    bench.device.transmit(bench.clock.now())
    assert not bench.device.firmware.laser
    assert bench.device.firmware.baud == (baud if baud < 200000 else 115200)
    lidar.close()


def test_closing_while_unplugged_does_not_fail():
    bench = Bench()
    lidar = bench.connect()
    bench.line.plugged = False
    lidar.close()
    lidar.service()
    with pytest.raises(LinkTimeoutError):
        read(lidar, 20, timeout=0.01)


def test_the_laser_is_stopped_when_connecting_is_interrupted():
    bench = Bench()

    class Interrupted(Wire):
        def write(self, data):
            super().write(data)
            if data.startswith(b"MD"):
                self._clock.sleep(0.5)
                raise KeyboardInterrupt

    bench.open_transport = lambda: Interrupted(bench.line, bench.clock)
    with pytest.raises(KeyboardInterrupt):
        bench.connect()
    assert not bench.device.firmware.laser


def test_garbled_scans_are_kept_and_counted_without_their_garbled_rows():
    bench = Bench(SERIAL)
    lidar = bench.connect("115200")
    bench.line.faults = Faults(drop=1e-4, insert=1e-4, flip=1e-4)
    lines = read(lidar, 200)
    bench.check(lines, 206, 562, garbled=True)
    turns = [KnownLidar.turn_at(line.stamp) for line in lines]
    assert turns[-1] - turns[0] + 1 - len(turns) == lidar.stats.bad <= 2
    garbled = sum(bool((line.codes == LOST).any()) for line in lines)
    assert 30 < garbled <= lidar.stats.garbled < 120
    assert garbled <= lidar.stats.lost_rows < 1.3 * garbled
    assert lidar.stats.reconnects == 0


def test_where_an_empty_line_is_garbled_both_scans_are_kept():
    bench = Bench()
    lidar = bench.connect()
    transmit = bench.device.transmit

    def transmit_garbled(now):
        data = transmit(now)
        return data[:-1] if int(now * 10) % 4 == 0 else data

    bench.device.transmit = transmit_garbled
    lines = read(lidar, 40)
    bench.check(lines, garbled=True)
    turns = np.array([KnownLidar.turn_at(line.stamp) for line in lines])
    assert (np.diff(turns) == 1).all()


@pytest.mark.parametrize("piece", [slice(0, 9), slice(17, 19), slice(21, 23)])
def test_a_scan_with_a_garbled_head_is_kept(piece):
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 5)
    transmit = bench.device.transmit

    def transmit_garbled(now):
        data = bytearray(transmit(now))
        if data and int(now * 10) % 3 == 0:
            data[piece] = bytes(len(data[piece]))
        return bytes(data)

    bench.device.transmit = transmit_garbled
    lines = read(lidar, 30)
    bench.check(lines)
    truth = [KnownLidar.stamp(KnownLidar.turn_at(line.stamp)) for line in lines]
    assert np.allclose([line.stamp for line in lines], truth, atol=0.006)
    assert (np.diff([KnownLidar.turn_at(line.stamp) for line in lines]) == 1).all()
    assert lidar.stats.garbled + lidar.stats.good == 35


@pytest.mark.parametrize("profile", [SERIAL, UrgProfile()])
@pytest.mark.parametrize("seconds", [0.3, 2.5, 8.0])
def test_scans_come_again_within_three_after_the_line_is_good_again(profile, seconds):
    bench = Bench(profile)
    lidar = bench.connect("115200")
    bench.line.faults = Faults(drop=0.1, insert=0.1, flip=0.1)
    until = bench.clock.now() + seconds
    while bench.clock.now() < until:
        bench.clock.sleep(0.01)
        lidar.service()
    bench.line.faults = Faults()
    while True:
        line = lidar.read_line(1.0)
        if line.stamp >= until - 2.0 * REVOLUTION:
            break
    assert bench.clock.now() - until <= 4 * REVOLUTION + 0.02
    bench.check([line, *read(lidar, 5)], 206, 562)


def test_a_million_corrupted_bytes():
    bench = Bench(UrgProfile(), Faults(), seed=5)
    lidar = bench.connect("usb")
    bench.line.faults = Faults(drop=3e-4, insert=3e-4, flip=3e-4)
    bench.line.passed = 0
    good = kept = wrong = 0
    while bench.line.passed < 1_000_000:
        try:
            line = lidar.read_line(2.0)
        except LinkTimeoutError:
            continue
        measured, arrived = KnownLidar.values(KnownLidar.turn_at(line.stamp)), line.codes != LOST
        good += bool(arrived.all())
        kept += arrived.mean()
        wrong += not np.array_equal(values_of(line)[arrived], measured[arrived])
    # 470 scans of 2137 bytes, each whole with probability exp(-1.9), each row with exp(-0.06).
    assert good > 30
    assert kept > 0.9 * 470
    assert wrong == 0
    assert lidar.bad > 300
    bench.line.faults = Faults()
    bench.check(read(lidar, 3)[-1:])


def test_a_million_bytes_of_garbage_are_no_scan():
    bench = Bench()
    lidar = bench.connect()
    rng = np.random.default_rng(0)
    line_of_noise = [*range(0x30, 0x70)] * 3 + [10] * 6
    lidar._clock.sleep(0.3)
    lidar.service()
    good = lidar.stats.good
    bench.device.transmit = lambda now: b""
    for _ in range(250):
        noise = rng.choice(line_of_noise, 4000).astype(np.uint8).tobytes()
        bench.line._arrived += noise
        lidar.service()
    assert lidar.stats.good == good


def test_stalls_are_waited_for():
    bench = Bench(UrgProfile(), seed=3)
    lidar = bench.connect()
    bench.line.faults = Faults(stalls=0.5, stall=0.6)
    lines = read(lidar, 100, timeout=2.0)
    bench.check(lines)
    turns = np.diff([KnownLidar.turn_at(line.stamp) for line in lines])
    assert (turns == 1).all()
    assert lidar.stats.reconnects == 0


def test_the_timer_wraps():
    bench = Bench(UrgProfile(timer_ms=(1 << 24) - 3000))
    lidar = bench.connect()
    lines = read(lidar, 40)
    bench.check(lines)
    truth = [KnownLidar.stamp(KnownLidar.turn_at(line.stamp)) for line in lines]
    assert np.allclose([line.stamp for line in lines], truth, atol=0.006)
    assert np.allclose(np.diff(truth), REVOLUTION)


@pytest.mark.parametrize("skew", [0.004, -0.004])
def test_the_skew_of_the_sensors_clock_is_found(skew):
    bench = Bench(UrgProfile(skew=skew))
    lidar = bench.connect()
    lines = read(lidar, 600)
    truth = np.array([KnownLidar.stamp(KnownLidar.turn_at(line.stamp)) for line in lines])
    error = np.array([line.stamp for line in lines]) - truth
    assert np.abs(error).max() < 0.012
    assert np.abs(error[100:]).max() < 0.008
    # 1 ms of resolution of the timer, and as much of the arrival.
    assert error[100:].std() < 0.002


def test_that_it_fell_silent_is_said_at_once():
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 3)
    bench.device.transmit = lambda now: b""
    with pytest.raises(LinkTimeoutError, match="the lidar fell silent"):
        read(lidar, 3, timeout=1.5)


@pytest.mark.parametrize("power", ["kept", "lost"])
@pytest.mark.parametrize("seconds", [0.2, 3.0])
def test_unplugged_and_plugged_in_again(power, seconds):
    bench = Bench(UrgProfile(usb=False, baud=19200, scip1=True, boot=0.5))
    lidar = bench.connect("115200")
    read(lidar, 5)
    bench.line.plugged = False
    lost = bench.clock.now()
    while bench.clock.now() < lost + seconds:
        bench.clock.sleep(0.02)
        lidar.service()
    assert "unplugged" in lidar.stats.problem
    bench.line.plugged = True
    if power == "lost":
        bench.device.power_up(bench.clock.now())
    back = bench.clock.now()
    lines = read(lidar, 10, timeout=8.0)
    fresh = [line for line in lines if line.stamp > back]
    bench.check(fresh, 206, 562)
    assert lidar.stats.reconnects == 1
    assert lidar.stats.problem == ""
    assert fresh[0].stamp - back < (1.0 if power == "kept" else 3.0)
    truth = [KnownLidar.stamp(KnownLidar.turn_at(line.stamp)) for line in fresh]
    assert np.allclose([line.stamp for line in fresh], truth, atol=0.02)


def test_reading_while_unplugged_says_so():
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 3)
    bench.line.plugged = False
    with pytest.raises(LinkTimeoutError, match=r"no scan line within 0\.5 s: .*unplugged"):
        read(lidar, 20, timeout=0.5)


def test_a_sensor_that_was_reset_streams_again():
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 5)
    bench.device.firmware.answer(b"RS", bench.clock.now(), set())
    lines = read(lidar, 20, timeout=3.0)
    bench.check(lines[-5:])
    assert lidar.stats.reconnects == 0


def test_a_sensor_that_lost_power_without_the_port_noticing():
    bench = Bench(UrgProfile(usb=False, baud=19200, scip1=True, boot=1.0))
    lidar = bench.connect("115200")
    read(lidar, 5)
    bench.device.power_up(bench.clock.now())
    lines = read(lidar, 20, timeout=15.0)
    bench.check(lines[-5:], 206, 562)
    assert lidar.stats.reconnects == 1


def test_a_malfunction_interrupts_the_stream_and_no_more():
    bench = Bench(UrgProfile(firmware=(3, 3, 1)))
    lidar = bench.connect()
    read(lidar, 3)
    wire = lidar._link._transport
    wire.write(b"DB03\n")
    with pytest.raises(LinkTimeoutError):
        read(lidar, 20, timeout=0.4)
    wire.write(b"DB10\n")
    bench.check(read(lidar, 5))


@pytest.mark.parametrize("profile", [SERIAL, UrgProfile()])
def test_after_planning_scans_arrive_without_a_new_request(profile, caplog):
    bench = Bench(profile)
    lidar = bench.connect("115200")
    read(lidar, 5)
    asked, bad = len(bench.requests()), lidar.stats.bad
    bench.clock.sleep(8.5)
    lines = read(lidar, 10)
    bench.check(lines, 206, 562)
    # What waited in the port is stale, and the rest of it was lost
    assert lines[0].stamp > bench.clock.now() - 1.5
    truth = [KnownLidar.stamp(KnownLidar.turn_at(line.stamp)) for line in lines]
    assert np.allclose([line.stamp for line in lines], truth, atol=0.006)
    assert (len(bench.requests()), lidar.stats.bad, caplog.messages) == (asked, bad, [])


@pytest.mark.parametrize("seconds", [1.6, 3.0, 5.0])
def test_a_sensor_that_starts_anew_at_each_request_is_given_time(seconds):
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 3)
    # No scan is sent until so long after the latest request
    transmit, since = bench.device.transmit, [bench.clock.now()]

    def transmit_late(now):
        data = transmit(now)
        if data.count(b"\n") > 4:
            return data if now - since[0] > seconds else b"00P\n\n"
        since[0] = now if b"MD" in data else since[0]
        return data

    bench.device.transmit = transmit_late
    bench.check(read(lidar, 3, timeout=12.0)[-1:])


def test_replies_with_cr_lf_are_understood():
    bench = Bench()
    transmit = bench.device.transmit
    bench.device.transmit = lambda now: transmit(now).replace(b"\n", b"\r\n")
    lidar = bench.connect()
    bench.check(read(lidar, 5))
    assert lidar.stats.bad == 0


def test_only_the_last_unread_lines_are_kept():
    bench = Bench()
    lidar = bench.connect()
    for _ in range(500):
        bench.clock.sleep(0.01)
        lidar.service()
    lines = read(lidar, 16, timeout=0.0)
    with pytest.raises(LinkTimeoutError, match="within 0 s"):
        lidar.read_line(0.0)
    assert bench.clock.now() - lines[-1].stamp < 0.25
    assert np.allclose(np.diff([line.stamp for line in lines]), REVOLUTION, atol=0.006)


def test_a_distance_beyond_the_data_sheet_is_no_distance():
    bench = Bench()
    values = np.full(682, 4095)
    values[1:4] = 4096, 5600, 19
    bench.device._lidar.values = lambda turn: values
    line = bench.connect().read_line(1.0)
    assert line.codes[:4].tolist() == [-1, 0, 0, 19]
    assert np.isnan(line.ranges[1:4]).all()
    assert line.ranges[0] == 4.095


def test_a_distance_that_cannot_be_is_left_out_and_said(caplog):
    bench = Bench()
    values = np.full(682, 1000)
    values[[5, 9]] = 5601
    bench.device._lidar.values = lambda turn: values
    lidar = bench.connect()
    for line in read(lidar, 3):
        assert np.flatnonzero(line.codes != VALID).tolist() == [5, 9]
        assert (line.codes[[5, 9]] == UNMEASURED).all()
        assert np.isnan(line.ranges[[5, 9]]).all()
    assert (lidar.stats.masked, lidar.stats.bad) == (6, 0)
    (message,) = caplog.messages
    assert "5601 mm at step 49, beyond its range of 5600 mm" in message


def test_why_scans_are_dropped_is_in_the_error_and_the_warning(caplog):
    bench = Bench()
    lidar = bench.connect()
    read(lidar, 3)
    transmit = bench.device.transmit
    bench.device.transmit = lambda now: transmit(now).replace(b"0", b"")
    with pytest.raises(LinkTimeoutError, match=r"no scan line within 0\.8 s: (no|a) scan"):
        read(lidar, 20, timeout=0.8)
    with pytest.raises(LinkTimeoutError, match=r"no good scan arrives \((no|a) scan"):
        read(lidar, 20, timeout=3.0)
    assert any(text.startswith("no good scan arrives (") for text in caplog.messages)
