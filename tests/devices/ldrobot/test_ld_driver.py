"""The driver of the LDROBOT lidars on the emulator, over good and bad lines."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from round_scene import RoundScene, true_range
from virtual import VirtualClock

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.types import UNMEASURED, VALID, ScanLine
from scan3d_twin.devices.ldrobot import model as ld
from scan3d_twin.devices.ldrobot.driver import LdLidar
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.ldrobot.model import LdModel
from scan3d_twin.devices.links.line_model import NO_FAULTS, Faults, Line, Wire


class Setup:
    """A driver on an emulator."""

    def __init__(
        self,
        model: LdModel = ld.LD19,
        faults: Faults = NO_FAULTS,
        speed: float = 10.0,
        seed: int = 0,
    ) -> None:
        self.clock = VirtualClock()
        self.scene = RoundScene(self.clock, model.spec, model.sample_rate, speed)
        self.emulator = LdEmulator(self.scene, model)
        self.line = Line(self.emulator, faults, seed)

    def open(self, model: LdModel = ld.LD19) -> LdLidar:
        return LdLidar(lambda: Wire(self.line, self.clock), self.clock, model)


def lines(lidar: LdLidar, count: int) -> Iterator[ScanLine]:
    for _ in range(count):
        yield lidar.read_line(1.0)


@pytest.mark.parametrize("model", [ld.LD06, ld.LD19, ld.STL27L])
@pytest.mark.parametrize("speed", [9.9, 10.0, 10.1])
def test_lines_have_the_angles_times_and_distances_of_the_scene(
    model: LdModel, speed: float
) -> None:
    setup = Setup(model, speed=speed)
    lidar = setup.open(model)
    for line in lines(lidar, 5):
        assert line.elevations is not None
        assert line.beam_times is not None
        there = np.flatnonzero(line.codes != UNMEASURED)
        assert abs(len(there) - model.sample_rate / speed) <= 1
        # A packet arrives 2 ms after its last reading, stamps are milliseconds
        assert line.stamp == pytest.approx(setup.scene.seam_before(line.stamp + 0.01), abs=0.002)
        elapsed = (line.elevations[there] + math.pi) / (math.tau * speed)
        assert np.allclose(line.beam_times[there], elapsed, atol=2e-4)
        valid = np.flatnonzero(line.codes == VALID)
        angle = np.radians(0.01)
        assert np.all(
            np.abs(line.ranges[valid] - true_range(line.elevations[valid])) <= 0.3 * angle + 0.0011
        )
        assert 0 < len(there) - len(valid) < 0.05 * len(there)
    assert lidar.bad == lidar.stats.reconnects == 0


def test_a_bad_line_lets_hardly_any_wrong_reading_through() -> None:
    setup = Setup(faults=Faults(drop=0.001, insert=0.001, flip=0.001), seed=3)
    lidar = setup.open()
    wrong = readings = 0
    for line in lines(lidar, 100):
        assert line.elevations is not None
        valid = np.flatnonzero(line.codes == VALID)
        off = np.abs(line.ranges[valid] - true_range(line.elevations[valid]))
        wrong += np.count_nonzero(off > 0.005)
        readings += len(valid)
    assert lidar.bad > 200
    assert readings > 0.7 * 100 * 430
    assert wrong <= 1


def test_after_the_line_was_unplugged_it_goes_on() -> None:
    setup = Setup()
    lidar = setup.open()
    lidar.read_line(1.0)
    setup.line.plugged = False
    with pytest.raises(LinkTimeoutError, match="unplugged"):
        list(lines(lidar, 30))
    setup.line.plugged = True
    for line in list(lines(lidar, 5))[-2:]:
        assert line.stamp == pytest.approx(setup.scene.seam_before(line.stamp + 0.01), abs=0.002)
    assert lidar.stats.reconnects == 1


@pytest.mark.parametrize("model", [ld.LD19, ld.STL27L])
@pytest.mark.parametrize("pause", [0.6, 8.5])
def test_after_planning_lines_arrive_and_what_waited_is_not_believed(
    model: LdModel, pause: float, caplog: pytest.LogCaptureFixture
) -> None:
    setup = Setup(model)
    lidar = setup.open(model)
    list(lines(lidar, 3))
    setup.clock.sleep(pause)
    if pause < 1:
        # Of what waits, all but the last 100 ms was lost
        setup.line.receive(setup.clock.now() - 0.1, model.baud)
    for line in lines(lidar, 5):
        assert line.stamp == pytest.approx(setup.scene.seam_before(line.stamp + 0.01), abs=0.002)
    assert line.stamp > setup.clock.now() - 0.3
    # Of what was lost, a packet was cut, and the next is in doubt
    assert lidar.bad == 2 * (pause < 1)
    assert (lidar.stats.reconnects, caplog.messages) == (0, [])


def test_after_close_the_port_stays_closed() -> None:
    setup = Setup()
    lidar = setup.open()
    lidar.close()
    opened = []
    lidar._open_transport = lambda: opened.append(1)
    for _ in range(100):
        lidar.service()
        setup.clock.sleep(0.05)
    assert not opened


@pytest.mark.parametrize("speed", [0.96, 0.975, 1.0, 1.025, 1.04])
def test_a_speed_that_is_accepted_fits_into_the_lines(speed: float) -> None:
    setup = Setup(speed=speed * ld.TURN_RATE)
    if abs(speed - 1) > ld.MAX_TURN_RATE_ERROR:
        with pytest.raises(LinkError, match="times a second"):
            setup.open()
        return
    for line in lines(setup.open(), 3):
        readings = np.count_nonzero(line.codes != UNMEASURED)
        assert readings == pytest.approx(setup.scene._rate / setup.scene._speed, abs=1)


def test_after_power_was_off_its_timer_begins_anew() -> None:
    setup = Setup()
    lidar = setup.open()
    lidar.read_line(1.0)
    setup.emulator.power_up(setup.clock.now())
    for line in list(lines(lidar, 20))[-2:]:
        assert line.stamp == pytest.approx(setup.scene.seam_before(line.stamp + 0.01), abs=0.002)


def test_the_timer_wraps_every_thirty_seconds() -> None:
    setup = Setup()
    lidar = setup.open()
    last = lidar.read_line(1.0).stamp
    while last < 32.0:
        stamp = lidar.read_line(1.0).stamp
        assert stamp - last == pytest.approx(0.1, abs=2e-3)
        last = stamp
    assert lidar.bad == 0


@pytest.mark.parametrize(
    ("speed", "opened", "emulated", "reason"),
    [
        (6.0, ld.LD19, ld.LD19, "turns 6.0 times a second.*PWM"),
        (10.0, ld.LD19, ld.STL27L, "is it another model|measures 21"),
    ],
)
def test_what_is_not_as_it_should_be_is_explained(
    speed: float, opened: LdModel, emulated: LdModel, reason: str
) -> None:
    setup = Setup(emulated, speed=speed)
    with pytest.raises(LinkError, match=reason):
        setup.open(opened)


def test_silence_and_foreign_bytes_are_explained() -> None:
    class Talker:
        baud = 230_400

        def __init__(self, data: bytes) -> None:
            self._data = data

        def receive(self, data: bytes, now: float) -> None:
            pass

        def transmit(self, now: float) -> bytes:
            data, self._data = self._data, b""
            return data

    for data, reason in (
        (b"", "no byte arrives"),
        (b"\xaa\x55\xf0\x0f" * 50, "COIN-D4"),
        (b"hello" * 50, "bytes arrive, but no packet"),
    ):
        clock, talker = VirtualClock(), Talker(b"")
        line = Line(talker)
        wire = Wire(line, clock)
        talker._data = data
        with pytest.raises(LinkTimeoutError, match=reason):
            LdLidar(lambda wire=wire: wire, clock, ld.LD19)
