from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.types import Hazards, Pose2, Scan3D, read_only, wrap, wrap_all

lengths = st.floats(-10.0, 10.0)
poses = st.builds(Pose2, lengths, lengths, st.floats(-10.0, 10.0))


def assert_same(a: Pose2, b: Pose2) -> None:
    """Assert that two poses are equal up to rounding."""
    assert (a.x, a.y) == pytest.approx((b.x, b.y), abs=1e-9)
    assert abs(wrap(a.yaw - b.yaw)) < 1e-9


@given(st.floats(-1e6, 1e6))
def test_wrap_is_in_half_open_interval_and_keeps_direction(angle: float) -> None:
    wrapped = wrap(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-6)


def test_many_angles_are_wrapped_as_one_is() -> None:
    angles = np.concatenate([np.linspace(-20.0, 20.0, 1001), math.pi * np.arange(-5, 6)])
    assert wrap_all(angles).tolist() == [wrap(angle) for angle in angles.tolist()]


def test_wrap_at_the_seam() -> None:
    assert wrap(math.pi) == -math.pi
    assert wrap(-math.pi) == -math.pi


@given(poses)
def test_inverse_undoes(a: Pose2) -> None:
    assert_same(a @ a.inverse(), Pose2())
    assert_same(a.inverse() @ a, Pose2())


@given(poses, poses, poses)
def test_composition_is_associative(a: Pose2, b: Pose2, c: Pose2) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))


@given(poses, poses)
def test_composition_agrees_with_matrices(a: Pose2, b: Pose2) -> None:
    assert np.allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)
    assert_same(Pose2.from_matrix((a @ b).matrix()), a @ b)


@given(poses)
def test_apply_agrees_with_matrix_and_keeps_z(a: Pose2) -> None:
    points = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 0.0]])
    homogeneous = np.column_stack([points, np.ones(2)])
    assert np.allclose(a.apply(points), (homogeneous @ a.matrix().T)[:, :3])


def test_read_only_copies_writable_input() -> None:
    source = np.zeros(3)
    result = read_only(source)
    source[0] = 1.0
    assert result[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        result[1] = 1.0


def test_last_and_first_lines_count_occupied_lines_only() -> None:
    lines = np.array([2, 2, 5, 7, 7, 7])
    scan = Scan3D(np.arange(18.0).reshape(6, 3), lines, np.zeros(6, dtype=int), 10)
    assert list(scan.last_lines(2).lines) == [5, 7, 7, 7]
    assert list(scan.last_lines(2).first_lines(1).lines) == [5]
    assert len(scan.last_lines(99)) == 6
    assert len(scan.last_lines(0)) == 0


def test_hazards_are_named_in_words() -> None:
    assert Hazards().active() == ()
    assert Hazards(bump_left=True, wheel_drop_right=True, battery=0.1).active() == (
        "bump left",
        "wheel drop right",
    )


def test_some_readings_lie_where_they_lie_among_all() -> None:
    image = synthetic.observe(Pose2(-0.4, 0.2, 0.1)).image
    rng = np.random.default_rng(0)
    lines, beams = (rng.integers(0, n, 500) for n in image.ranges.shape)
    assert np.array_equal(image.points_at(lines, beams), image.points[lines, beams], equal_nan=True)
    assert np.array_equal(image.directions_at(lines, beams), image.directions[lines, beams])


def test_rounding_does_not_decide_on_readings_at_a_limit() -> None:
    image = synthetic.observe(Pose2(-0.4, 0.0, 0.0)).image
    ranges = np.full(image.ranges.shape, 4.0)
    ranges[0], ranges[1], ranges[2] = 4.0 + 1e-12, 4.001, np.nan
    within = replace(image, ranges=read_only(ranges)).ranges_within(4.0)
    assert within[0].all()
    assert not within[1:3].any()
    assert within[3:].all()
