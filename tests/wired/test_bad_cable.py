"""Sweeps over bad cables, against the lines that the lidar itself measured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.config import Config
from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import UNMEASURED, VALID, LidarSpec, ScanLine
from scan3d_twin.devices.device import Wiring
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.registry import base_device, lidar_device
from scan3d_twin.real.robot import open_over
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_robot
from scan3d_twin.wired import HazardFreeClock

pytestmark = pytest.mark.slow

CONFIG = replace(
    Config(),
    sweep=replace(Config().sweep, width=math.radians(40.0), margin=math.radians(5.0)),
    motion=replace(Config().motion, turn_rate=math.radians(45.0)),
)
"""Times of turns decide which byte a fault hits, and the seeds stand for certain ones."""


class RecordedLidar:
    """A lidar whose lines are kept."""

    def __init__(self, lidar: Lidar) -> None:
        self.lines: list[ScanLine] = []
        self._lidar = lidar

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar``."""
        return self._lidar.spec

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar``."""
        self.lines.append(self._lidar.read_line(timeout))
        return self.lines[-1]


def sweep_over(corrupt: float, seed: int) -> tuple[float, float, float, int]:
    """Return duration [s], lost share, largest error of a stamp [s] and wrong values of a sweep.

    Args:
        corrupt: Probability of losing a byte, of inserting one and of altering one, on both lines.
        seed: Draws the robot's errors and the faults.
    """
    twin = TwinConfig()
    with open_robot("three_boxes", seed, twin) as robot:
        # Emulate the devices
        clock, measured = HazardFreeClock(robot.clock), RecordedLidar(robot.lidar)
        base = Line(base_device(twin.robot).emulate(robot.base), seed=seed)
        device = lidar_device(twin.lidar_model).emulate(measured, Wiring(usb=True))
        lidar = Line(device, seed=seed + 1)

        # Sweep over their lines
        links = Wire(base, clock), lambda: Wire(lidar, clock)
        with open_over(*links, clock, twin.devices) as driven:
            base.faults = lidar.faults = Faults(corrupt, corrupt, corrupt)
            began = clock.now()
            image = sweep(driven, 0.0, CONFIG, lambda line: None).image
            took = clock.now() - began

    # Compare with what was measured
    stamps = np.array([line.stamp for line in measured.lines])
    nearest = np.abs(stamps[:, None] - image.stamps[None, :]).argmin(axis=0)
    offsets = image.stamps - stamps[nearest]
    true = np.array([measured.lines[k].ranges for k in nearest])
    wrong = (image.codes == VALID) & ~(np.abs(image.ranges - true) < 5e-4)
    spread = float(np.abs(offsets - np.median(offsets)).max())
    return took, float((image.codes == UNMEASURED).mean()), spread, int(wrong.sum())


def test_a_sweep_over_a_bad_cable_takes_little_longer_and_holds_no_wrong_value() -> None:
    """Of 69 other sweeps at 0.001, three had stamps off by more than 6 ms, 7.3 ms at most."""
    clean, lost, _, wrong = sweep_over(0.0, 1000)
    assert (lost, wrong) == (0.0, 0)
    took, lost, spread, wrong = sweep_over(1e-4, 1000)
    assert took < 1.1 * clean
    assert 0.01 < lost < 0.04
    assert (wrong, spread < 0.006) == (0, True)
    for seed in (1000, 1001):
        took, lost, spread, wrong = sweep_over(1e-3, seed)
        assert took < 1.5 * clean
        assert 0.15 < lost < 0.25
        assert (wrong, spread < 0.006) == (0, True)


def test_a_sweep_in_which_the_base_is_sent_to_another_baud_rate_is_finished(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """In this one a garbled byte sends the base to 300 bit/s while it turns."""
    took, lost, spread, wrong = sweep_over(1e-3, 1021)
    assert "the base has not answered" in caplog.text
    assert took < 20.0
    assert 0.15 < lost < 0.25
    assert (wrong, spread < 0.006) == (0, True)
