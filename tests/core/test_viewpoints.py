from __future__ import annotations

import math

import numpy as np
import pytest
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.scanning.target_extraction import all_points, extract_target
from scan3d_twin.core.types import Pose2, RangeImage, Scan3D
from scan3d_twin.core.viewpoints import (
    FRONT_SIDE,
    MAX_INCIDENCE,
    angle_between,
    bends_after,
    contour_of,
    corner_angle,
    ends_in_view,
    first_segment,
    limit,
    next_segment,
    place,
    sweep_width,
    trace,
    well_seen,
)

CONFIG = paper_config()
AHEAD = np.array([-1.0, 0.0])
WALL = (Box((1.0, -5.0, 0.0), (1.1, 5.0, 2.5)),)
BOX = (Box((1.0, -0.2, 0.0), (1.3, 0.2, 0.5)),)


def seen(pose: Pose2, boxes: tuple[Box, ...]) -> tuple[RangeImage, Scan3D, Scan3D]:
    image = observe(pose, boxes, room=False).image
    sweep = all_points(image, CONFIG)
    known = pose.inverse().apply(np.array([[1.0, 0.0], [1.0, -3.0], [1.0, 3.0]]))
    return image, sweep, extract_target(image, sweep, known, CONFIG.target)


def flat(n: int = 101, width: float = 1.0) -> np.ndarray:
    return np.column_stack([np.ones(n), np.linspace(width / 2, -width / 2, n)])


def test_the_contour_of_a_wall_is_straight_and_its_normal_faces_the_robot() -> None:
    contour = contour_of(seen(Pose2(), WALL)[2])
    assert contour.width == pytest.approx(2 * math.tan(math.radians(30.0)), abs=0.02)
    assert contour.normal(0) == pytest.approx(AHEAD, abs=1e-3)


def test_niches_do_not_count() -> None:
    points = flat()
    points[40:60, 0] += 0.15
    contour = trace(points)
    assert contour.width == pytest.approx(1.0)
    assert contour.points[50] == pytest.approx([1.0, 0.0], abs=0.005)


def test_a_convex_corner_counts_in_full() -> None:
    a = np.column_stack([np.linspace(1.3, 1.0, 31), np.linspace(0.3, 0.0, 31)])
    b = np.column_stack([np.linspace(1.01, 1.3, 30), np.linspace(-0.01, -0.3, 30)])
    contour = trace(np.concatenate([a, b]))
    assert contour.width == pytest.approx(0.6 * math.sqrt(2), abs=0.01)
    bend = angle_between(contour.normal(0, 30), contour.normal(30))
    assert bend == pytest.approx(math.pi / 2, abs=0.02)


@pytest.mark.parametrize("overlap", [0.2, 0.5, 0.8])
def test_on_a_wall_the_next_view_is_parallel_and_shares_the_overlap(overlap: float) -> None:
    points = flat()
    n_Q = round(overlap * len(points))
    segment = next_segment(trace(points), n_Q, 1.0, None, ends=False)
    viewpoint = segment.viewpoint(1.0)
    assert viewpoint.x == pytest.approx(0.0, abs=1e-6)
    assert viewpoint.y == pytest.approx(-(1.0 - overlap), abs=0.02)  # to the right
    assert viewpoint.yaw == pytest.approx(0.0, abs=1e-6)


def test_where_the_target_ends_the_view_turns_around_it() -> None:
    small = next_segment(trace(flat(41, 0.4)), 33, 1.0, None, ends=True).viewpoint(1.0)
    large = next_segment(trace(flat(41, 0.4)), 21, 1.0, None, ends=True).viewpoint(1.0)
    assert math.degrees(small.yaw) == pytest.approx(0.2 * 90.0, abs=3.0)
    assert math.degrees(large.yaw) == pytest.approx(0.5 * 90.0, abs=3.0)
    assert large.y < small.y < 0


def test_q_is_never_left_at_a_flat_angle() -> None:
    viewpoint = next_segment(trace(flat(41, 0.4)), 2, 1.0, None, ends=True).viewpoint(1.0)
    assert viewpoint.yaw == pytest.approx(MAX_INCIDENCE, abs=1e-6)


def test_a_curved_body_is_followed_as_it_curves() -> None:
    angles = np.radians(np.linspace(20.0, -20.0, 21))
    arc = np.column_stack([1.15 - 0.15 * np.cos(angles), 0.15 * np.sin(angles)])
    contour = trace(arc)
    segment = next_segment(contour, 10, 1.0, None, ends=True, bend=corner_angle(contour))
    assert math.degrees(segment.viewpoint(1.0).yaw) == pytest.approx(0.5 * 40.0, abs=4.0)


def test_waves_on_a_face_do_not_hide_that_it_ends() -> None:
    points = flat(41, 0.4)
    points[:, 0] += 0.02 * np.sin(np.linspace(0.0, 10 * math.pi, 41))
    viewpoint = next_segment(trace(points), 21, 1.0, None, ends=True).viewpoint(1.0)
    assert math.degrees(viewpoint.yaw) == pytest.approx(0.5 * 90.0, abs=3.0)


def test_the_end_of_a_box_is_seen_and_that_of_a_wall_is_not() -> None:
    assert ends_in_view(*seen(Pose2(), BOX), CONFIG.target)
    assert not ends_in_view(*seen(Pose2(), WALL), CONFIG.target)


def test_something_nearer_beside_the_target_is_not_its_end() -> None:
    hiding = Box((0.5, -0.35, 0.0), (0.6, -0.12, 0.5))
    image, sweep, target = seen(Pose2(), (*BOX, hiding))
    assert not ends_in_view(image, sweep, target, CONFIG.target)


def test_flat_lines_at_the_far_end_of_a_wall_do_not_count() -> None:
    contour = contour_of(seen(Pose2(0.0, 0.0, math.radians(-45.0)), WALL)[2])
    k = well_seen(contour)
    last = contour.points[k - 1]
    incidence = angle_between(contour.normal(0, k - 1), -last)
    assert k < len(contour.points)
    assert abs(math.degrees(incidence)) == pytest.approx(math.degrees(MAX_INCIDENCE), abs=2.0)
    assert not bends_after(contour, k)


def test_a_side_seen_flat_around_a_corner_is_a_bend() -> None:
    contour = contour_of(seen(Pose2(0.0, -0.35, 0.0), BOX)[2])
    k = well_seen(contour)
    assert k < len(contour.points)
    assert bends_after(contour, k)


def test_a_tour_of_the_front_begins_around_its_left_end() -> None:
    viewpoint = first_segment(trace(flat()), 1.0, from_left=True).viewpoint(1.0)
    assert viewpoint.yaw == pytest.approx(-FRONT_SIDE)
    assert viewpoint.y == pytest.approx(0.5 + math.sin(FRONT_SIDE))


def test_a_tour_all_round_begins_where_the_robot_stands() -> None:
    viewpoint = first_segment(trace(flat() + np.array([0.5, 0.0])), 1.0, from_left=False).viewpoint(
        1.0
    )
    assert (viewpoint.x, viewpoint.y, viewpoint.yaw) == pytest.approx((0.5, 0.0, 0.0), abs=1e-6)


def test_limit_turns_just_as_far_as_needed() -> None:
    turned = Pose2(0.0, 0.0, math.radians(80.0)).apply(AHEAD)
    assert angle_between(AHEAD, limit(turned, AHEAD, 0.5)) == pytest.approx(0.5)
    assert limit(turned, AHEAD, 2.0) == pytest.approx(turned)


def test_place_takes_the_wanted_viewpoint_when_it_can() -> None:
    segment = next_segment(trace(flat()), 50, 1.0, None, ends=False)
    viewpoint, wanted = place(segment, CONFIG, lambda _: True)
    assert (viewpoint, wanted) == (segment.viewpoint(CONFIG.planning.standoff), True)
    wanted_y = segment.viewpoint(1.0).y
    other, wanted = place(segment, CONFIG, lambda pose: pose.y > wanted_y + 0.1)
    assert other is not None
    assert not wanted
    aim = other @ Pose2(math.hypot(*(segment.middle - (other.x, other.y))), 0.0, 0.0)
    assert (aim.x, aim.y) == pytest.approx(tuple(segment.middle))
    assert place(segment, CONFIG, lambda _: False) == (None, False)


def test_sweep_width_is_what_sixty_degrees_cover() -> None:
    assert sweep_width(CONFIG) == pytest.approx(2 * math.tan(math.radians(30.0)))
