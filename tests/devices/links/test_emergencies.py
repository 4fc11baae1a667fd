"""Garbage on both lines, swapped ports, and hazards in the middle of a sweep, in virtual time.

``SCAN3D_TWIN_EMERGENCIES=20`` tries each 20 times, at other moments.
"""

import math
import os
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from kinematic import JumpingClock, KinematicBase
from paper import paper_config
from virtual import KnownLidar, values_of

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.core.navigation.wheel_kinematics import WHEEL_ACCELERATION
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import Hazards
from scan3d_twin.devices.create.driver import STOP
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.link import HALF_DRIVE
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links.line_model import Line, Wire
from scan3d_twin.devices.links.transport import Reopening
from scan3d_twin.devices.urg.emulator import UrgEmulator
from scan3d_twin.real.robot import open_over

pytestmark = [
    pytest.mark.slow,
    pytest.mark.parametrize("seed", range(int(os.environ.get("SCAN3D_TWIN_EMERGENCIES", "1")))),
]
QUICK = paper_config()
QUICK = replace(QUICK, sweep=replace(QUICK.sweep, width=0.6, margin=0.0, yaw_rate=0.3))
GARBAGE = 400
"""Bytes of garbage: a fifth of a scan, five frames of the base."""


class PluggedClock(JumpingClock):
    """A clock that plugs lines in again when it is time."""

    def __init__(self, base):
        super().__init__(base)
        self.lines, self.back = [], math.inf

    def unplug(self, lines, seconds):
        self.lines, self.back = lines, self.now() + seconds
        for line in lines:
            line.plugged = False

    def sleep(self, seconds):
        super().sleep(seconds)
        if self.now() >= self.back:
            for line in self.lines:
                line.plugged = True


class Bed:
    """A robot on emulated devices whose sweep meets an emergency at a random line."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.base = KinematicBase(acceleration=WHEEL_ACCELERATION)
        self.clock = PluggedClock(self.base)
        self.create, self.urg = CreateEmulator(self.base), UrgEmulator(KnownLidar(self.clock))
        self.lines = [Line(self.create, seed=seed), Line(self.urg, seed=seed + 1)]
        self.at, self.happened = 4 + int(self.rng.integers(10)), math.inf
        self.scans = []

    def open(self, *, swapped=False):
        base, lidar = self.lines[::-1] if swapped else self.lines
        link = Reopening(lambda: Wire(base, self.clock), self.clock, HALF_DRIVE + STOP)
        return open_over(link, lambda: Wire(lidar, self.clock), self.clock)

    def sweep(self, robot, emergency):
        def on_line(scan):
            self.scans.append(scan)
            if len(self.scans) == self.at:
                self.happened = self.clock.now()
                emergency()

        return sweep(robot, 0.0, QUICK, on_line)

    def moved_since(self, begin):
        """Return when the wheels turned from ``begin`` [s] on."""
        samples = self.base.odometry_since(begin)
        return [b.stamp for a, b in pairwise(samples) if a.T_odom_base != b.T_odom_base]

    def stood_after(self):
        """Return how long the wheels still turned after the emergency [s]."""
        return max(self.moved_since(self.happened), default=self.happened) - self.happened


def is_whole(image, spec):
    """Return whether a sweep has no hole and its whole width."""
    yaws = image.yaws[:, image.yaws.shape[1] // 2]
    spacing = QUICK.sweep.yaw_rate * spec.line_period
    width = yaws[0] - yaws[-1]
    return -np.diff(yaws).min() < 1.6 * spacing and abs(width - QUICK.sweep.width) < 2 * spacing


def test_garbage_in_mid_sweep_loses_no_part_of_it_and_gives_no_wrong_value(seed):
    bed = Bed(seed)

    def garbage():
        for line in bed.lines:
            line._store(bed.rng.bytes(GARBAGE))

    with bed.open() as robot:
        image = bed.sweep(robot, garbage).image
    assert is_whole(image, robot.lidar.spec)
    for scan in bed.scans:
        turn = KnownLidar.turn_at(scan.stamp)
        assert np.array_equal(values_of(scan), KnownLidar.values(turn))


@pytest.mark.parametrize(
    ("hazard", "words"),
    [
        (Hazards(battery=0.05), "low battery"),
        (Hazards(overcurrent_left=True, overcurrent_right=True), "overcurrent left"),
        (Hazards(bump_right=True), "bump right"),
    ],
    ids=["low battery", "stall", "bump"],
)
def test_a_hazard_in_mid_sweep_stops_the_wheels(seed, hazard, words):
    bed = Bed(seed)
    with bed.open() as robot, pytest.raises(HazardError, match=f"stopped: {words}"):
        bed.sweep(robot, lambda: setattr(bed.base, "hazard", hazard))
    assert bed.stood_after() < 0.5
    bed.clock.sleep(0.1)
    bed.lines[0].receive(bed.clock.now(), 115200)
    assert bed.create.mode is Mode.PASSIVE
    assert len(bed.scans) >= bed.at


def test_a_bump_at_every_move_stops_each_and_loses_no_way(seed):
    bed = Bed(seed)
    with bed.open() as robot:
        for _ in range(5):
            # Bump
            robot.base.set_velocity(0.1, 0.0)
            robot.clock.sleep(float(bed.rng.uniform(0.2, 1.0)))
            bed.happened, bed.base.hazard = bed.clock.now(), Hazards(bump_left=True)
            with pytest.raises(HazardError, match="stopped: bump left"):
                robot.clock.sleep(1.0)
            robot.clock.sleep(0.6)
            assert bed.stood_after() < 0.5

            # Back off
            robot.base.set_velocity(-0.1, 0.0)
            robot.clock.sleep(0.3)
            bed.base.hazard = Hazards()
            robot.base.set_velocity(0.0, 0.0)
            robot.clock.sleep(0.3)
        way = robot.base.odometry().T_odom_base.x
    assert way > 0.05
    assert way == pytest.approx(bed.base.odometry().T_odom_base.x, abs=0.003)


@pytest.mark.parametrize("gone", [[0], [1], [0, 1]], ids=["base", "lidar", "both"])
def test_a_port_that_is_gone_and_back_stops_the_wheels_and_loses_no_part(seed, gone, monkeypatch):
    bed = Bed(seed)
    stops, set_velocity = [], bed.base.set_velocity

    def record(linear, angular):
        if linear == angular == 0:
            stops.append(bed.clock.now())
        return set_velocity(linear, angular)

    monkeypatch.setattr(bed.base, "set_velocity", record)
    seconds = float(bed.rng.uniform(0.2, 2.0))
    with bed.open() as robot:
        image = bed.sweep(
            robot, lambda: bed.clock.unplug([bed.lines[which] for which in gone], seconds)
        ).image
    assert is_whole(image, robot.lidar.spec)
    for scan in bed.scans:
        turn = KnownLidar.turn_at(scan.stamp)
        assert np.array_equal(values_of(scan), KnownLidar.values(turn))
    # A base that hears nothing drives on: it is stopped as soon as it is back, and sweeps on
    if 0 in gone:
        assert any(0 <= stop - bed.clock.back < 0.5 for stop in stops)


def test_an_emulator_that_is_killed_ends_the_sweep_with_its_reason(seed):
    bed = Bed(seed)
    with pytest.raises(LinkError, match="unplugged for 30 s"), bed.open() as robot:
        bed.sweep(robot, lambda: bed.clock.unplug(bed.lines, math.inf))
    assert bed.clock.now() < bed.happened + 32.0


def test_swapped_ports_are_said_and_nothing_moves(seed):
    bed = Bed(seed)
    with pytest.raises(LinkError, match="this is the lidar's port"), bed.open(swapped=True):
        pass
    assert bed.base.speed == (0.0, 0.0)
    assert bed.clock.now() < 10.0
