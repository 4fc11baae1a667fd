from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_sweep

from scan3d_twin.core.errors import DataLossError
from scan3d_twin.core.hal import Lidar, Robot
from scan3d_twin.core.scanning.deskew import Lines
from scan3d_twin.core.scanning.lost_readings import (
    DOUBTED_BEAMS,
    drop_doubtful,
    find_holes,
    merge_intervals,
)
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import (
    LOST,
    UNMEASURED,
    VALID,
    BoolArray,
    FloatArray,
    LidarSpec,
    Observation,
    ScanLine,
    read_only,
)
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim

SPACING = math.radians(0.5)
HALF = 20 * SPACING
YAWS = np.arange(20, -21, -1) * SPACING
ROW = 22


def holes(lost: BoolArray) -> list[tuple[float, float]]:
    """Return the holes wider than 5.5 spacings and 8 beams, in spacings."""
    order = np.random.default_rng(0).permutation(len(YAWS))
    found = find_holes(YAWS[order], lost[order], HALF, SPACING, 5.5 * SPACING, 8)
    return [(round(left / SPACING, 3), round(right / SPACING, 3)) for left, right in found]


def nothing_lost() -> BoolArray:
    """Return a mask of 41 lines of 100 beams."""
    return np.zeros((len(YAWS), 100), dtype=bool)


def test_only_what_is_wide_both_ways_is_a_hole() -> None:
    lost = nothing_lost()
    lost[10:14, 20:60] = True  # narrow across lines
    lost[20:40, 70:77] = True  # narrow along the lines
    assert holes(lost) == []
    lost[10:15, 20:28] = True
    assert holes(lost) == [(11.0, 5.0)]


def test_rows_lost_by_turns_leave_no_hole() -> None:
    lost = nothing_lost()
    lost[::2, :50] = lost[1::2, 50:] = True
    assert holes(lost) == []


def test_holes_that_overlap_and_holes_at_the_ends() -> None:
    lost = nothing_lost()
    lost[:5, 0:20] = lost[12:18, 0:20] = lost[15:25, 60:80] = lost[-6:, 90:] = True
    assert holes(lost) == [(20.5, 15.0), (9.0, -5.0), (-14.0, -20.5)]


def test_missing_lines_are_no_holes() -> None:
    lost = nothing_lost()[::8]
    assert find_holes(YAWS[::8], lost, HALF, SPACING, 5.5 * SPACING, 8) == []


def test_intervals_close_to_each_other_are_one() -> None:
    intervals = [(1.0, 0.0), (9.0, 8.0), (7.5, 7.0), (0.5, -1.0)]
    assert merge_intervals(intervals, 0.0) == [(9.0, 8.0), (7.5, 7.0), (1.0, -1.0)]
    assert merge_intervals(intervals, 0.6) == [(9.0, 7.0), (1.0, -1.0)]


def plane(lost: int) -> Lines:
    """Return 41 lines of a plane at 1 m, with so many readings lost in the first."""
    lines = []
    for yaw in YAWS:
        ranges = np.full(100, 1.0 / math.cos(yaw))
        lines.append((ScanLine(0.0, read_only(ranges), np.full(100, VALID)), np.full(100, yaw)))
    line, yaws = lines[0]
    codes = np.where(np.arange(100) < lost, LOST, line.codes)
    lines[0] = (replace(line, codes=codes, ranges=np.where(codes == LOST, np.nan, 1.0)), yaws)
    return lines


def with_error(lines: Lines, error: float) -> Lines:
    """Return ``lines`` with one reading of line 20 wrong by ``error`` [m]."""
    line, yaws = lines[20]
    ranges = line.ranges + np.where(np.arange(100) == 50, error, 0.0)
    return [*lines[:20], (replace(line, ranges=ranges), yaws), *lines[21:]]


@pytest.mark.parametrize("error", [-0.064, 0.064, 1.0])
def test_a_reading_unlike_its_neighbours_is_doubted_with_its_row(error: float) -> None:
    dropped = drop_doubtful(with_error(plane(lost=22), error))
    codes = np.array([line.codes for line, _ in dropped]) == LOST
    assert np.flatnonzero(codes.any(axis=1)).tolist() == [0, 20]
    doubted = np.flatnonzero(codes[20])
    assert (doubted[0], doubted[-1]) == (50 - DOUBTED_BEAMS, 50 + DOUBTED_BEAMS)
    assert np.isnan(dropped[20][0].ranges[doubted]).all()


def test_nothing_is_doubted_where_nothing_was_lost_or_readings_agree() -> None:
    intact = with_error(plane(lost=0), 1.0)
    assert drop_doubtful(intact) is intact
    dropped = drop_doubtful(with_error(plane(lost=22), 0.05))
    assert sum(int((line.codes == LOST).sum()) for line, _ in dropped) == 22


class GarbledLidar:
    """A lidar of whose rows of readings a share is lost on the way."""

    def __init__(self, lidar: Lidar, share: float) -> None:
        self.share, self.lines = share, 0
        self._lidar, self._rng = lidar, np.random.default_rng(0)

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar``."""
        return self._lidar.spec

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar``."""
        line = self._lidar.read_line(timeout)
        self.lines += 1
        rows = self._rng.random(-(-self.spec.n_beams // ROW)) < self.share
        lost = np.repeat(rows, ROW)[: self.spec.n_beams]
        return replace(
            line,
            ranges=read_only(np.where(lost, np.nan, line.ranges)),
            codes=read_only(np.where(lost, LOST, line.codes), np.int64),
        )


CONFIG = paper_config(sweep=paper_sweep(width=math.radians(20.0)))


def garbled_sweep(share: float, retries: int = 5) -> tuple[Observation, GarbledLidar]:
    """Return a sweep of which a share of the rows is lost at each pass."""
    config = replace(CONFIG, sweep=replace(CONFIG.sweep, retries=retries))
    with open_sim("three_boxes", 1000, TwinConfig.ideal()) as (robot, _):
        lidar = GarbledLidar(robot.lidar, share)
        one = Robot(robot.base, lidar, robot.clock, robot.T_base_lidar)
        return sweep(one, 0.0, config, lambda line: None), lidar


def widest_hole(observation: Observation) -> float:
    """Return the widest angle between two lines with readings of a row, in spacings."""
    image = observation.image
    front: FloatArray = image.yaws[:, image.spec.n_beams // 2]
    spacing = CONFIG.sweep.yaw_rate * image.spec.line_period
    known = image.codes[:, ROW // 2 :: ROW] != UNMEASURED
    return max(float(-np.diff(front[column]).min()) for column in known.T) / spacing


def test_a_sweep_scans_wide_holes_again_and_leaves_narrow_ones() -> None:
    whole, once = garbled_sweep(0.0)
    assert not (whole.image.codes == UNMEASURED).any()
    few, lidar = garbled_sweep(0.1)
    assert not (few.image.codes == LOST).any()
    assert 0.05 < (few.image.codes == UNMEASURED).mean() < 0.15
    assert lidar.lines == once.lines
    many, again = garbled_sweep(0.5)
    assert again.lines > 1.5 * lidar.lines
    # Gap filling closes 3 degrees
    assert widest_hole(many) * math.degrees(CONFIG.sweep.yaw_rate) * 0.1 < 3.0


def test_holes_that_stay_are_an_error() -> None:
    with pytest.raises(DataLossError, match="gaps in the sweep are left after 0 more passes"):
        garbled_sweep(0.6, retries=0)


def test_lost_readings_are_filled_so_that_the_floor_stays_known() -> None:
    garbled, _ = garbled_sweep(0.2)
    image = garbled.image
    filled = (image.codes == UNMEASURED) & np.isfinite(image.ranges)
    whole, _ = garbled_sweep(0.0)
    # Where the lines at both sides see the same surface, which most of them do
    assert filled.mean() > 0.5 * (image.codes == UNMEASURED).mean() > 0.05
    seen = np.isfinite(image.ranges).mean()
    assert seen > np.isfinite(whole.image.ranges).mean() - 0.06
    # They are on the surfaces that the whole sweep sees there
    n = min(image.n_lines, whole.image.n_lines)
    off = np.abs(image.ranges[:n] - whole.image.ranges[:n])[filled[:n]]
    assert np.nanmedian(off) < 0.005
