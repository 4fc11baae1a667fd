from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from synthetic import THREE_BOXES, Box, observe

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.scanning.target.selection import find_target, find_targets, is_empty
from scan3d_twin.core.types import VALID, Observation, Pose2, read_only

CONFIG = paper_config()
SPAWN = Pose2(-0.9, 0.0, 0.0)


def look(
    boxes: tuple[Box, ...] = THREE_BOXES, *, room: bool = True, spawn: Pose2 = SPAWN
) -> Observation:
    """Return a panorama of ``boxes``, with ``odom`` at the robot."""
    seen = observe(spawn, boxes, width=math.tau - 1e-3, step=math.radians(2.0), room=room)
    return Observation(seen.image, Pose2())  # odom is where the robot was opened


def test_the_look_around_finds_the_boxes_not_the_room() -> None:
    hint = find_target(look(), None, CONFIG)
    assert hint[:, 0].min() == pytest.approx(1.5, abs=0.02)
    assert hint[:, 1].min() == pytest.approx(-1.15, abs=0.08)
    assert hint[:, 1].max() == pytest.approx(1.15, abs=0.08)
    assert hint[:, 0].max() < 2.2  # the wall behind is at 3.4


@pytest.mark.parametrize("beam", [330, 384, 410])
def test_a_glint_beside_the_boxes_makes_no_wall_of_them(beam: int) -> None:
    seen = look()
    image, whole = seen.image, find_target(seen, None, CONFIG)
    bearing = math.atan2(whole[:, 1].max(), whole[np.argmax(whole[:, 1]), 0])
    beside = np.flatnonzero(image.yaws[:, 384] > bearing)[-1]
    ranges, codes = image.ranges.copy(), image.codes.copy()
    ranges[beside, beam], codes[beside, beam] = 1.0, VALID
    glint = replace(seen, image=replace(image, ranges=read_only(ranges), codes=read_only(codes)))
    assert np.array_equal(find_target(glint, None, CONFIG), whole)


def test_a_wall_is_found_when_there_is_nothing_else() -> None:
    wall = (Box((1.3, -5.0, 0.0), (1.4, 5.0, 2.5)),)
    hint = find_target(look(wall, room=False, spawn=Pose2(0.0, 4.0, 0.0)), None, CONFIG)
    assert np.ptp(hint[:, 1]) > 3.0
    assert hint[:, 0].min() == pytest.approx(1.3, abs=0.01)


@pytest.mark.parametrize("y", [0.0, 1.0, 1.2])
def test_a_thing_at_a_wall_is_preferred_to_the_wall(y: float) -> None:
    """Seen from beside it, its side leads to the wall without a step in depth."""
    thing = Box((0.0, -0.35, 0.0), (0.4, 0.35, 0.7))
    wall = Box((0.4, -3.0, 0.0), (0.5, 3.0, 2.5))
    spawn = Pose2(-1.7, y, 0.0)
    found = find_target(look((thing, wall), room=False, spawn=spawn), None, CONFIG)
    hint = found + np.array([-1.7, y])
    assert hint.min(axis=0) == pytest.approx([0.0, -0.35], abs=0.07)
    assert hint[:, 0].max() < 0.4
    assert hint[:, 1].max() == pytest.approx(0.35, abs=0.07)


STEPPED = (Box((0.22, -0.8, 0.0), (0.5, 0.0, 0.6)), Box((0.0, 0.0, 0.0), (0.5, 0.4, 0.6)))
RECEDING = (Box((0.0, 0.0, 0.0), (0.9, 0.2, 0.5)),)


@pytest.mark.parametrize(
    ("thing", "spawn"),
    [(STEPPED, (-1.7, 0.0)), (STEPPED, (-1.7, -0.3)), (RECEDING, (-1.4, -0.6))],
)
def test_a_thing_in_pieces_is_preferred_to_a_small_one_at_a_wall(
    thing: tuple[Box, ...], spawn: tuple[float, float]
) -> None:
    """Two lines on a face that recedes, or beside a step, are far apart, with nothing between."""
    x, y = spawn
    room = (
        Box((x - 0.7, -3.0, 0.0), (x - 0.6, 3.0, 2.5)),  # close behind the robot
        Box((2.5, -2.5, 0.0), (2.6, 2.5, 2.5)),
        Box((-2.5, 2.5, 0.0), (2.5, 2.6, 2.5)),
        Box((-2.5, -2.6, 0.0), (2.5, -2.5, 2.5)),
    )
    small = Box((-1.4, 2.15, 0.0), (-1.2, 2.35, 0.25))
    seen = look((*thing, *room, small), room=False, spawn=Pose2(x, y, 0.0))
    first, *others = (hint + spawn for hint in find_targets(seen, 3, CONFIG))
    low, high = (np.array([getattr(box, end)[:2] for box in thing]) for end in ("low", "high"))
    assert np.ptp(first, axis=0).max() > 0.65
    assert np.all((first > low.min(axis=0) - 0.02) & (first < high.max(axis=0) + 0.02))
    (other,) = others
    assert other[:, 1].min() > 2.1


def test_readings_scattered_in_the_air_are_no_thing() -> None:
    """As the floor leaves them, where the mount is off; a thing at a wall is the target."""
    thing = Box((0.0, -0.35, 0.0), (0.4, 0.35, 0.7))
    wall = Box((0.4, -3.0, 0.0), (0.5, 3.0, 2.5))
    seen = look((thing, wall), room=False, spawn=Pose2(-1.7, 0.0, 0.0))
    whole = find_target(seen, None, CONFIG)

    # Twelve readings, each farther than a depth edge from its neighbours
    image = seen.image
    ranges, codes = image.ranges.copy(), image.codes.copy()
    line = int(np.argmin(np.abs(image.yaws[:, 384] - math.radians(70.0))))
    for k in range(12):
        at = line + k // 4, 330 + 2 * (k % 4)
        ranges[at], codes[at] = 0.8 + 0.15 * (k % 3), VALID
    scattered = replace(
        seen, image=replace(image, ranges=read_only(ranges), codes=read_only(codes))
    )
    assert np.array_equal(find_target(scattered, None, CONFIG), whole)


def test_what_an_uneven_wall_leaves_is_no_thing_at_it() -> None:
    ledge = Box((0.3, -0.35, 0.0), (0.4, 0.35, 0.7))
    wall = Box((0.4, -3.0, 0.0), (0.5, 3.0, 2.5))
    hint = find_target(look((ledge, wall), room=False, spawn=Pose2(-1.7, 0.6, 0.0)), None, CONFIG)
    assert np.ptp(hint[:, 1]) > 1.0


def test_a_room_is_empty_when_nothing_stands_in_it() -> None:
    wall = (Box((1.3, -5.0, 0.0), (1.4, 5.0, 2.5)),)
    assert is_empty(look(()), CONFIG)
    assert is_empty(look((), room=False), CONFIG)
    assert not is_empty(look(), CONFIG)
    assert not is_empty(look(wall, room=False), CONFIG)


def test_the_wanted_place_overrides_what_is_salient() -> None:
    small = Box((-0.2, 1.2, 0.0), (0.0, 1.4, 0.3))
    scene = (*THREE_BOXES, small)
    assert find_target(look(scene), None, CONFIG)[:, 0].min() > 1.0
    hint = find_target(look(scene), (0.75, 1.25), CONFIG)
    assert hint[:, 0].max() < 1.0
    assert hint[:, 1].min() == pytest.approx(1.2, abs=0.05)


def test_nothing_near_the_wanted_place_is_an_error_that_says_so() -> None:
    with pytest.raises(SceneError, match=r"no target within 0.5 m of \(-0.90, 0.30\)"):
        find_target(look(), (-0.9, 0.3), CONFIG)


def test_an_empty_floor_is_an_error_that_says_so() -> None:
    with pytest.raises(SceneError, match="shows nothing within 4 m"):
        find_target(look((), room=False), None, CONFIG)


def test_a_twig_close_by_is_less_salient_than_a_box_behind_it() -> None:
    """The twig fills more of the view; the box shows more area."""
    box = Box((1.6, -0.3, 0.0), (2.0, 0.3, 0.6))
    twig = Box((0.3, 0.35, 0.0), (0.45, 0.5, 0.9))
    look = observe(Pose2(), (box, twig), width=math.tau - 1e-3, step=math.radians(2.0))
    found = find_target(look, None, paper_config())
    assert found[:, 0].min() > 1.4


def test_of_two_alike_the_one_ahead_is_the_target() -> None:
    ahead, behind = Box((1.3, -0.3, 0.0), (1.6, 0.3, 0.6)), Box((-1.5, -0.3, 0.0), (-1.2, 0.3, 0.6))
    look = observe(Pose2(), (ahead, behind), width=math.tau - 1e-3, step=math.radians(2.0))
    assert find_target(look, None, paper_config())[:, 0].min() > 1.0
