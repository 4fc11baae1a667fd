from __future__ import annotations

import math

import numpy as np
import pytest
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.scanning.target.extraction import extract_points, extract_target
from scan3d_twin.core.types import Pose2, RangeImage, Scan3D
from scan3d_twin.core.viewpoints import (
    MAX_FRONT_ANGLE,
    MAX_INCIDENCE,
    choose_viewpoint,
    count_well_seen,
    estimate_corner_angle,
    extract_contour,
    find_first_segment,
    find_next_segment,
    has_corner_after,
    is_end_in_view,
    limit_direction,
    measure_angle,
    measure_sweep_width,
    trace_contour,
)

CONFIG = paper_config()
AHEAD = np.array([-1.0, 0.0])
WALL = (Box((1.0, -5.0, 0.0), (1.1, 5.0, 2.5)),)
BOX = (Box((1.0, -0.2, 0.0), (1.3, 0.2, 0.5)),)


def seen(pose: Pose2, boxes: tuple[Box, ...]) -> tuple[RangeImage, Scan3D, Scan3D]:
    """Return the range image at ``pose``, all its points and those of the target."""
    image = observe(pose, boxes, room=False).image
    sweep = extract_points(image, CONFIG)
    known = pose.inverse().apply(np.array([[1.0, 0.0], [1.0, -3.0], [1.0, 3.0]]))
    return image, sweep, extract_target(image, sweep, known, CONFIG.target)


def flat(n: int = 101, width: float = 1.0) -> np.ndarray:
    """Return the top view (n, 2) of a flat wall 1 m ahead."""
    return np.column_stack([np.ones(n), np.linspace(width / 2, -width / 2, n)])


def test_the_contour_of_a_wall_is_straight_and_its_normal_faces_the_robot() -> None:
    contour = extract_contour(seen(Pose2(), WALL)[2])
    assert contour.width == pytest.approx(2 * math.tan(math.radians(30.0)), abs=0.02)
    assert contour.normal(0) == pytest.approx(AHEAD, abs=1e-3)


def test_niches_do_not_count() -> None:
    points = flat()
    points[40:60, 0] += 0.15
    contour = trace_contour(points)
    assert contour.width == pytest.approx(1.0)
    assert contour.points[50] == pytest.approx([1.0, 0.0], abs=0.005)


def test_a_convex_corner_counts_in_full() -> None:
    a = np.column_stack([np.linspace(1.3, 1.0, 31), np.linspace(0.3, 0.0, 31)])
    b = np.column_stack([np.linspace(1.01, 1.3, 30), np.linspace(-0.01, -0.3, 30)])
    contour = trace_contour(np.concatenate([a, b]))
    assert contour.width == pytest.approx(0.6 * math.sqrt(2), abs=0.01)
    bend = measure_angle(contour.normal(0, 30), contour.normal(30))
    assert bend == pytest.approx(math.pi / 2, abs=0.02)


@pytest.mark.parametrize("overlap", [0.2, 0.5, 0.8])
def test_on_a_wall_the_next_view_is_parallel_and_shares_the_overlap(overlap: float) -> None:
    points = flat()
    n_Q = round(overlap * len(points))
    segment = find_next_segment(trace_contour(points), n_Q, 1.0, None, ends=False)
    viewpoint = segment.viewpoint(1.0)
    assert viewpoint.x == pytest.approx(0.0, abs=1e-6)
    assert viewpoint.y == pytest.approx(-(1.0 - overlap), abs=0.02)  # to the right
    assert viewpoint.yaw == pytest.approx(0.0, abs=1e-6)


def test_where_the_target_ends_the_view_turns_around_it() -> None:
    small = find_next_segment(trace_contour(flat(41, 0.4)), 33, 1.0, None, ends=True).viewpoint(1.0)
    large = find_next_segment(trace_contour(flat(41, 0.4)), 21, 1.0, None, ends=True).viewpoint(1.0)
    assert math.degrees(small.yaw) == pytest.approx(0.2 * 90.0, abs=3.0)
    assert math.degrees(large.yaw) == pytest.approx(0.5 * 90.0, abs=3.0)
    assert large.y < small.y < 0


def test_q_is_never_left_at_a_flat_angle() -> None:
    viewpoint = find_next_segment(trace_contour(flat(41, 0.4)), 2, 1.0, None, ends=True).viewpoint(
        1.0
    )
    assert viewpoint.yaw == pytest.approx(MAX_INCIDENCE, abs=1e-6)


def test_a_curved_body_is_followed_as_it_curves() -> None:
    angles = np.radians(np.linspace(20.0, -20.0, 21))
    arc = np.column_stack([1.15 - 0.15 * np.cos(angles), 0.15 * np.sin(angles)])
    contour = trace_contour(arc)
    segment = find_next_segment(
        contour, 10, 1.0, None, ends=True, bend=estimate_corner_angle(contour)
    )
    assert math.degrees(segment.viewpoint(1.0).yaw) == pytest.approx(0.5 * 40.0, abs=4.0)


def test_waves_on_a_face_do_not_hide_that_it_ends() -> None:
    points = flat(41, 0.4)
    points[:, 0] += 0.02 * np.sin(np.linspace(0.0, 10 * math.pi, 41))
    viewpoint = find_next_segment(trace_contour(points), 21, 1.0, None, ends=True).viewpoint(1.0)
    assert math.degrees(viewpoint.yaw) == pytest.approx(0.5 * 90.0, abs=3.0)


def test_the_end_of_a_box_is_seen_and_that_of_a_wall_is_not() -> None:
    assert is_end_in_view(*seen(Pose2(), BOX), CONFIG.target)
    assert not is_end_in_view(*seen(Pose2(), WALL), CONFIG.target)


def test_something_nearer_beside_the_target_is_not_its_end() -> None:
    hiding = Box((0.5, -0.35, 0.0), (0.6, -0.12, 0.5))
    image, sweep, target = seen(Pose2(), (*BOX, hiding))
    assert not is_end_in_view(image, sweep, target, CONFIG.target)


def test_flat_lines_at_the_far_end_of_a_wall_do_not_count() -> None:
    contour = extract_contour(seen(Pose2(0.0, 0.0, math.radians(-45.0)), WALL)[2])
    k = count_well_seen(contour)
    last = contour.points[k - 1]
    incidence = measure_angle(contour.normal(0, k - 1), -last)
    assert k < len(contour.points)
    assert abs(math.degrees(incidence)) == pytest.approx(math.degrees(MAX_INCIDENCE), abs=2.0)
    assert not has_corner_after(contour, k)


def test_a_side_seen_flat_around_a_corner_is_a_bend() -> None:
    contour = extract_contour(seen(Pose2(0.0, -0.35, 0.0), BOX)[2])
    k = count_well_seen(contour)
    assert k < len(contour.points)
    assert has_corner_after(contour, k)


def test_a_tour_of_the_front_begins_around_its_left_end() -> None:
    viewpoint = find_first_segment(trace_contour(flat()), 1.0, from_left=True).viewpoint(1.0)
    assert viewpoint.yaw == pytest.approx(-MAX_FRONT_ANGLE)
    assert viewpoint.y == pytest.approx(0.5 + math.sin(MAX_FRONT_ANGLE))


def test_a_tour_all_round_begins_where_the_robot_stands() -> None:
    viewpoint = find_first_segment(
        trace_contour(flat() + np.array([0.5, 0.0])), 1.0, from_left=False
    ).viewpoint(1.0)
    assert (viewpoint.x, viewpoint.y, viewpoint.yaw) == pytest.approx((0.5, 0.0, 0.0), abs=1e-6)


def test_limit_turns_just_as_far_as_needed() -> None:
    turned = Pose2(0.0, 0.0, math.radians(80.0)).apply(AHEAD)
    assert measure_angle(AHEAD, limit_direction(turned, AHEAD, 0.5)) == pytest.approx(0.5)
    assert limit_direction(turned, AHEAD, 2.0) == pytest.approx(turned)


def test_place_takes_the_wanted_viewpoint_when_it_can() -> None:
    segment = find_next_segment(trace_contour(flat()), 50, 1.0, None, ends=False)
    viewpoint, wanted = choose_viewpoint(segment, CONFIG, lambda _: True)
    assert (viewpoint, wanted) == (segment.viewpoint(CONFIG.planning.standoff), True)
    wanted_y = segment.viewpoint(1.0).y
    other, wanted = choose_viewpoint(segment, CONFIG, lambda pose: pose.y > wanted_y + 0.1)
    assert other is not None
    assert not wanted
    aim = other @ Pose2(math.hypot(*(segment.middle - (other.x, other.y))), 0.0, 0.0)
    assert (aim.x, aim.y) == pytest.approx(tuple(segment.middle))
    assert choose_viewpoint(segment, CONFIG, lambda _: False) == (None, False)


def test_sweep_width_is_what_sixty_degrees_cover() -> None:
    assert measure_sweep_width(CONFIG) == pytest.approx(2 * math.tan(math.radians(30.0)))
