"""The whole loop with a lidar whose lines interleave, and whose beams come in any order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.types import LidarSpec, ScanLine, read_only

pytestmark = pytest.mark.slow

SEED = 1003


class Interleaved:
    """Every other beam of a lidar, those in between on every other line, from any of them on."""

    def __init__(self, lidar: Lidar) -> None:
        self._lidar, self._count, whole = lidar, 0, lidar.spec
        self.spec: LidarSpec = replace(
            whole,
            elevations=read_only(whole.elevations[::2]),
            beam_times=read_only(whole.beam_times[::2]),
        )

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        line, spec = self._lidar.read_line(timeout), self._lidar.spec
        beams = np.arange(self._count % 2, spec.n_beams, 2)
        beams = np.roll(beams, 37 * self._count)
        self._count += 1
        return arrange_line(
            self.spec, line.stamp, spec.elevations[beams], spec.beam_times[beams],
            line.ranges[beams], line.codes[beams],
        )  # fmt: skip


def test_a_scene_is_digitised_as_accurately() -> None:
    with s3d.open_sim("three_boxes", seed=SEED) as (robot, truth):
        shifted = replace(robot, lidar=Interleaved(robot.lidar))
        session = s3d.digitize(shifted, s3d.Config(max_views=3))
    for view in session.views:
        own = view.image.elevations
        assert own is not None
        assert np.median(np.abs(own[1:] - own[:-1])) == pytest.approx(np.pi / 512, rel=0.01)
        assert len(view.target) > 3000
    pairs = s3d.evaluate(session, truth).pairs
    assert len(pairs) == 2
    assert all(each.error < 0.010 < each.odometry_error for each in pairs)
