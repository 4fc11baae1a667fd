"""Sweeps over bad cables: how much longer they take, what is lost, and how much of it is wrong.

``python benchmarks/bad_cable.py [--corrupt 0.0001 0.001] [--seeds 10] [--scene three_boxes]``; one
line per probability. The real drivers drive the emulated robot in virtual time, with the defaults
of a sweep; bytes are lost, inserted and altered with this probability each, on both lines.
"""

from __future__ import annotations

import argparse

import numpy as np

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

FIRST_SEED = 1000
"""The gates have the seeds below."""


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


def sweep_over(scene: str, corrupt: float, seed: int) -> tuple[float, float, int, int]:
    """Return duration [s], lost share, wrong readings and all readings of one sweep."""
    twin = TwinConfig()
    with open_robot(scene, seed, twin) as robot:
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
            image = sweep(driven, 0.0, Config(), lambda line: None).image
            took = clock.now() - began

    # Compare with what was measured
    stamps = np.array([line.stamp for line in measured.lines])
    nearest = np.abs(stamps[:, None] - image.stamps[None, :]).argmin(axis=0)
    true = np.array([measured.lines[k].ranges for k in nearest])
    valid = image.codes == VALID
    wrong = valid & ~(np.abs(image.ranges - true) < 5e-4)
    return took, float((image.codes == UNMEASURED).mean()), int(wrong.sum()), int(valid.sum())


def main() -> None:
    """Print one line per probability."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--corrupt", type=float, nargs="+", default=[1e-4, 1e-3])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--scene", default="three_boxes")
    options = parser.parse_args()

    seeds = range(FIRST_SEED, FIRST_SEED + options.seeds)
    clean = [sweep_over(options.scene, 0.0, seed)[0] for seed in seeds]
    for corrupt in options.corrupt:
        found = [sweep_over(options.scene, corrupt, seed) for seed in seeds]
        times = [each[0] / before for each, before in zip(found, clean, strict=True)]
        print(
            f"{corrupt:g}: {np.mean(times):.2f} times as long, at most {max(times):.2f}; "
            f"{np.mean([each[1] for each in found]):.1%} lost; "
            f"{sum(each[2] for each in found)} wrong of {sum(each[3] for each in found)} readings",
            flush=True,
        )


if __name__ == "__main__":
    main()
