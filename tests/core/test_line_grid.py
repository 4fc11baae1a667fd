"""Beams at any angles on a grid of lines and beams."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.line_grid import (
    arrange_line,
    count_columns_per_beam,
    find_packed_columns,
    pack_columns,
)
from scan3d_twin.core.types import (
    UNMEASURED,
    VALID,
    FloatArray,
    LidarSpec,
    Pose2,
    RangeImage,
    ScanLine,
    read_only,
)

SPEC = synthetic.spec(100)
STEP = math.tau / 1024


def arrange(angles: FloatArray, spec: LidarSpec = SPEC) -> ScanLine:
    """Arrange readings each of which has a time, a range and a code that tell which one it is."""
    k = np.arange(len(angles))
    codes = np.where(k % 3 == 0, 7, VALID)
    return arrange_line(
        spec, 4.5, angles, 0.001 * k, np.where(k % 3 == 0, math.nan, k + 1.0), codes
    )


def test_a_line_on_the_grid_stays_as_it_is() -> None:
    line = arrange(np.array(SPEC.elevations))
    assert line.stamp == 4.5
    assert np.array_equal(line.elevations, SPEC.elevations)
    assert np.array_equal(line.beam_times, 0.001 * np.arange(100))
    assert np.array_equal(line.ranges[1:3], [2.0, 3.0])
    assert np.array_equal(line.codes[:3], [7, VALID, VALID])


@given(st.integers(0, 2**32 - 1))
def test_every_reading_keeps_what_belongs_to_it_near_its_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.permutation(rng.uniform(-40.0, 40.0, 60) * STEP)
    line = arrange(angles)
    assert line.elevations is not None
    assert line.beam_times is not None
    there = np.flatnonzero(line.codes != UNMEASURED)
    own = np.rint(line.beam_times[there] / 0.001).astype(int)
    assert len(np.unique(own)) == len(there) > 30
    assert np.array_equal(line.elevations[there], angles[own])
    valid = own % 3 != 0
    assert np.array_equal(line.ranges[there[valid]], own[valid] + 1.0)
    assert np.all(np.isnan(line.ranges[there[~valid]]))
    off = (line.elevations[there] - SPEC.elevations[there]) / STEP
    assert np.all(np.abs(off) <= 1.51)
    assert np.all(np.diff(line.elevations[there]) >= 0)
    assert np.all(np.isfinite(line.elevations))
    assert np.all(np.isfinite(line.beam_times))
    assert np.all(np.isnan(line.ranges[line.codes == UNMEASURED]))


@given(st.floats(1.0, 1.1), st.floats(-1.0, 1.0))
def test_no_reading_is_lost_of_beams_that_are_no_denser_than_the_grid(
    spacing: float, phase: float
) -> None:
    """A revolution that takes longer than nominal has fewer beams, at other angles."""
    angles = (np.arange(80) - 40) * spacing * STEP + phase * STEP
    line = arrange(angles)
    assert np.count_nonzero(line.codes != UNMEASURED) == 80


@pytest.mark.parametrize("phase", [0.5 - 1e-12, 0.5, 0.5 + 1e-12])
def test_beams_between_two_places_leave_no_holes(phase: float) -> None:
    line = arrange((np.arange(80) - 40 + phase) * STEP)
    there = np.flatnonzero(line.codes != UNMEASURED)
    assert np.array_equal(there, there[0] + np.arange(80))


def test_readings_beyond_the_ends_are_dropped() -> None:
    line = arrange((np.arange(300) - 150) * STEP)
    assert np.all(line.codes != UNMEASURED)
    assert np.array_equal(line.elevations, (np.arange(300) - 150)[100:200] * STEP)


def test_a_line_without_angles_is_refused() -> None:
    with pytest.raises(ConfigError, match="angles"):
        arrange(np.zeros(0))
    with pytest.raises(ConfigError, match="angles"):
        arrange_line(SPEC, 0.0, np.zeros(3), np.zeros(2), np.zeros(3), np.zeros(3, np.int64))


def spread(image: RangeImage, columns: int) -> RangeImage:
    """Return ``image`` with its readings ``columns`` apart, those of every other line one later."""
    shape = (image.n_lines, columns * image.spec.n_beams)
    at = columns * np.arange(image.spec.n_beams) + (np.arange(image.n_lines) % 2)[:, None]
    ranges, codes = np.full(shape, np.nan), np.zeros(shape, np.int64)
    np.put_along_axis(ranges, at, image.ranges, axis=1)
    np.put_along_axis(codes, at, image.codes, axis=1)
    steps = np.arange(shape[1]) / columns
    spec = replace(
        image.spec,
        elevations=read_only(image.spec.elevations[0] + steps * STEP),
        beam_times=read_only(image.spec.beam_times[0] + steps * 0.1 / 1024),
    )
    return replace(
        image,
        yaws=read_only(np.repeat(image.yaws, columns, axis=1)),
        ranges=read_only(ranges),
        codes=read_only(codes, np.int64),
        spec=spec,
    )


def test_unevenly_spaced_beams_on_a_doubled_grid_are_packed() -> None:
    rng = np.random.default_rng(2)
    fine = synthetic.spec(400)
    steps = (np.arange(180) - 90) * 2.0
    lines = [arrange((steps + rng.uniform(-0.7, 0.7, 180)) * STEP, fine) for _ in range(40)]
    codes = np.array([np.where(line.codes == UNMEASURED, UNMEASURED, VALID) for line in lines])
    columns = find_packed_columns(codes)
    assert columns is not None
    taken = np.take_along_axis(codes, columns, axis=1)
    assert np.count_nonzero(taken == VALID) > 0.9 * np.count_nonzero(codes == VALID)


@pytest.mark.parametrize("columns", [2, 3, 4])
def test_a_grid_of_several_columns_for_each_beam_is_packed(columns: int) -> None:
    image = synthetic.observe(Pose2()).image
    wide = spread(image, columns)
    assert count_columns_per_beam(wide.codes) == columns
    packed_columns = find_packed_columns(wide.codes)
    assert packed_columns is not None
    packed = pack_columns(wide, packed_columns)
    assert packed.spec.n_beams == image.spec.n_beams
    assert np.array_equal(packed.ranges, image.ranges, equal_nan=True)
    seen, dense = (np.isfinite(each.ranges) for each in (wide, packed))
    assert np.array_equal(packed.points[dense], wide.points[seen])
    assert find_packed_columns(packed.codes) is None


def test_a_dense_grid_is_left_alone() -> None:
    codes = np.array(synthetic.observe(Pose2()).image.codes)
    assert find_packed_columns(codes) is None
    codes[np.random.default_rng(0).random(codes.shape) < 0.4] = 0
    assert find_packed_columns(codes) is None
    assert find_packed_columns(np.zeros((50, 100), np.int64)) is None
    for share in (0.02, 0.1, 0.2, 0.3, 0.5):  # by chance, however few there are
        few = np.random.default_rng(1).random((60, 200)) < share
        assert find_packed_columns(np.where(few, VALID, 0)) is None
    assert find_packed_columns(np.full((50, 4), VALID)) is None
