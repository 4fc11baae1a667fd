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
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.links.line_model import Line, Wire
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


class Bed:
    """A robot on emulated devices whose sweep meets an emergency at a random line."""

    def __init__(self, seed):
        self.rng = np.random.default_rng(seed)
        self.base = KinematicBase(acceleration=WHEEL_ACCELERATION)
        self.clock = JumpingClock(self.base)
        self.create, self.urg = CreateEmulator(self.base), UrgEmulator(KnownLidar(self.clock))
        self.lines = [Line(self.create, seed=seed), Line(self.urg, seed=seed + 1)]
        self.at, self.happened = 4 + int(self.rng.integers(10)), math.inf
        self.scans = []

    def open(self, *, swapped=False):
        base, lidar = self.lines[::-1] if swapped else self.lines
        link = Wire(base, self.clock)
        return open_over(link, lambda: Wire(lidar, self.clock), self.clock)

    def sweep(self, robot, emergency):
        def on_line(scan):
            self.scans.append(scan)
            if len(self.scans) == self.at:
                self.happened = self.clock.now()
                emergency()

        return sweep(robot, 0.0, QUICK, on_line)

    def stood_after(self):
        """Return how long the wheels still turned after the emergency [s]."""
        samples = self.base.odometry_since(self.happened)
        moved = [b.stamp for a, b in pairwise(samples) if a.T_odom_base != b.T_odom_base]
        return max(moved, default=self.happened) - self.happened


def test_garbage_in_mid_sweep_loses_no_part_of_it_and_gives_no_wrong_value(seed):
    bed = Bed(seed)

    def garbage():
        for line in bed.lines:
            line._store(bed.rng.bytes(GARBAGE))

    with bed.open() as robot:
        image = bed.sweep(robot, garbage).image
    yaws = image.yaws[:, image.yaws.shape[1] // 2]
    spacing = QUICK.sweep.yaw_rate * robot.lidar.spec.line_period
    assert -np.diff(yaws).min() < 1.6 * spacing
    assert yaws[0] - yaws[-1] == pytest.approx(QUICK.sweep.width, abs=2 * spacing)
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


def test_swapped_ports_are_said_and_nothing_moves(seed):
    bed = Bed(seed)
    with pytest.raises(LinkError, match="this is the lidar's port"), bed.open(swapped=True):
        pass
    assert bed.base.speed == (0.0, 0.0)
    assert bed.clock.now() < 10.0
