"""What ``make demo`` does: the picture in the README, and no run that stands on a threshold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.types import ScanLine

pytestmark = pytest.mark.slow

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "three_boxes.svg"


class Shifted:
    """A lidar whose readings are off by about 1e-9 m, as on a computer that rounds otherwise."""

    def __init__(self, lidar: Lidar) -> None:
        self._lidar, self._rng = lidar, np.random.default_rng(0)
        self.spec = lidar.spec

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        line = self._lidar.read_line(timeout)
        return replace(
            line, ranges=line.ranges + 1e-9 * self._rng.standard_normal(len(line.ranges))
        )


def test_the_picture_in_the_readme_is_what_the_demo_leaves(tmp_path: Path) -> None:
    left = s3d.run_sim("three_boxes", out=tmp_path / "run")
    assert (left.folder / "top_view.svg").read_bytes() == PICTURE.read_bytes()

    with s3d.open_sim("three_boxes") as (robot, truth):
        session = s3d.digitize(replace(robot, lidar=Shifted(robot.lidar)))
        coverage = s3d.evaluate(session, truth).coverage
    assert len(session.views) == len(left.session.views)
    assert coverage == pytest.approx(left.report["coverage_20mm"], abs=0.002)
