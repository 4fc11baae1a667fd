"""A device is unplugged in the middle of a sweep of the twin, and perhaps plugged in again."""

import math
from contextlib import contextmanager

import numpy as np
import pytest

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.sweep import look_around, sweep
from scan3d_twin.emulator.create import CreateEmulator
from scan3d_twin.emulator.line import Line, Wire
from scan3d_twin.emulator.urg import UrgEmulator
from scan3d_twin.emulator.urg_profile import UrgProfile
from scan3d_twin.protocols.urg04lx import LINKS
from scan3d_twin.real.robot import open_over
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import Unhindered


class Accident(Unhindered):
    """A clock at whose will a plug is out, and the device behind it without power."""

    def __init__(self, clock, line, seconds):
        super().__init__(clock)
        self.line, self.seconds, self.out = line, seconds, None

    def sleep(self, seconds):
        super().sleep(seconds)
        if self.out is not None:
            plugged = not 0.0 <= self.now() - self.out < self.seconds
            if plugged and not self.line.plugged:
                self.line.device.power_up(self.now())
            self.line.plugged = plugged


@contextmanager
def opened(profile, link, seconds):
    """A robot whose lidar goes away for ``seconds`` when the clock's ``out`` is set."""
    with open_sim("plain_wall", 3, TwinConfig(lidar_link=link)) as (twin, _):
        line = Line(UrgEmulator(twin.lidar, profile))
        clock = Accident(twin.clock, line, seconds)
        base = Wire(CreateEmulator(twin.base), clock)
        with open_over(base, lambda: Wire(line, clock), clock, LINKS[link]) as robot:
            yield robot, clock


def unplug_at(number, clock, stamps):
    """Return an observer of lines that pulls the plug at one of them."""

    def on_line(line):
        stamps.append(line.stamp)
        if len(stamps) == number:
            clock.out = clock.now()

    return on_line


SERIAL = UrgProfile(usb=False, baud=19200, scip1=True)


@pytest.mark.parametrize(
    ("profile", "link", "seconds"),
    [(UrgProfile(), "usb", 0.3), (UrgProfile(), "usb", 20.0), (SERIAL, "115200", 2.0)],
)
def test_the_sweep_is_completed_and_nothing_is_lost(profile, link, seconds):
    config = Config()
    with opened(profile, link, seconds) as (robot, clock):
        stamps = []
        image = sweep(robot, 0.0, config, unplug_at(40, clock, stamps)).image
        assert robot.lidar.stats.reconnects == 1
    assert np.diff(stamps).max() > seconds + profile.boot
    yaws = image.yaws[:, image.yaws.shape[1] // 2]
    spacing = config.sweep.yaw_rate * robot.lidar.spec.line_period
    assert -np.diff(yaws).min() < 1.6 * spacing
    assert yaws[0] - yaws[-1] == pytest.approx(config.sweep.width, abs=2 * spacing)


def test_a_look_around_is_completed_too():
    with opened(UrgProfile(), "usb", 5.0) as (robot, clock):
        image = look_around(robot, Config(), unplug_at(60, clock, [])).image
    yaws = np.sort(image.yaws[:, image.yaws.shape[1] // 2])
    assert np.diff(yaws).max() < math.radians(10.5)
    assert yaws[-1] - yaws[0] > math.radians(358)


def test_a_lidar_that_stays_away_ends_the_sweep_and_the_robot_stood_meanwhile():
    with opened(UrgProfile(), "usb", math.inf) as (robot, clock):
        with pytest.raises(LinkTimeoutError, match=r"no scan line within 60 s: .*unplugged"):
            sweep(robot, 0.0, Config(), unplug_at(40, clock, []))
        stood = robot.base.odometry_since(clock.out + 3.0)
    assert clock.now() - clock.out < 65.0
    assert stood[-1].T_odom_base == stood[0].T_odom_base
    assert stood[-1].stamp - stood[0].stamp > 55.0


def test_a_base_that_is_unplugged_ends_the_sweep_with_a_clear_error():
    # Its odometry and its safety sensors are gone, so the run cannot go on; views are kept.
    with open_sim("plain_wall", 3) as (twin, _):
        line = Line(CreateEmulator(twin.base))
        clock = Unhindered(twin.clock)
        lidar = UrgEmulator(twin.lidar)
        wire = Wire(line, clock)
        with open_over(wire, lambda: Wire(lidar, clock), clock, LINKS["usb"]) as robot:
            seen = []

            def on_line(scan):
                seen.append(scan)
                line.plugged = len(seen) < 40

            with pytest.raises(LinkError, match="unplugged: check the cable"):
                sweep(robot, 0.0, Config(), on_line)
    assert len(seen) == 40
