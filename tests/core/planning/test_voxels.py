from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from paper import paper_config
from sessions import BOX, session_at

from scan3d_twin.core.planning.surface.surface_patches import (
    Eye,
    Patches,
    extract_patches,
    extract_view_patches,
    merge_patches,
)
from scan3d_twin.core.planning.surface.voxels import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    VOXEL_SIZE,
    VoxelMap,
    build_voxel_map,
    find_occupied_voxels,
    is_passed,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2, read_only

EYE = Eye(0.30, math.radians(30.0), math.radians(37.5), 4.0)


@pytest.fixture(scope="module")
def box() -> Session:
    """Return a session in front of a box."""
    return session_at(BOX, half=0.3)


@pytest.fixture(scope="module")
def space(box: Session) -> VoxelMap:
    """Return the voxel map around the box."""
    return build_voxel_map(box, 1.0)


def label(space: VoxelMap, x: float, y: float, z: float) -> int:
    """Return the label of the voxel at a point in ``world``."""
    index = int(space.indices(np.array([x, y, z])))
    assert index >= 0
    return int(space.labels.ravel()[index])


def test_before_the_box_is_free_its_front_occupied_and_behind_unknown(space: VoxelMap) -> None:
    assert label(space, 0.6, 0.0, 0.3) == FREE
    assert label(space, 0.91, 0.0, 0.3) == OCCUPIED
    assert label(space, 1.2, 0.0, 0.3) == UNKNOWN
    assert label(space, 1.7, 0.0, 0.3) == UNKNOWN


def test_occupied_voxels_are_those_of_the_map(box: Session, space: VoxelMap) -> None:
    middles = find_occupied_voxels(box, 1.0)
    flat = space.indices(middles)
    assert np.array_equal(flat, np.flatnonzero(space.labels.ravel() == OCCUPIED))


def test_more_of_the_target_may_be_just_beside_what_was_seen_of_it(space: VoxelMap) -> None:
    more = space.origin + (np.argwhere(space.may_hold_more) + 0.5) * VOXEL_SIZE
    assert len(more)
    front = np.abs(more[:, 0] - 0.9) + np.maximum(np.abs(more[:, 1]) - 0.3, 0)
    assert front.max() < 0.35
    assert np.all(more[:, 0] > 0.85)  # nothing unknown towards the robot


def test_rays_meet_what_stands_first(space: VoxelMap) -> None:
    reach = 2.0
    rays = space.march(Pose2(), EYE, reach)
    ahead = rays.first[len(rays.first) // 2]
    cell = np.array(np.unravel_index(ahead, space.labels.shape))
    place = space.origin + (cell + 0.5) * VOXEL_SIZE
    assert place == pytest.approx([0.9, 0.0, 0.3], abs=0.06)
    assert rays.count_met(space.target) > 50


def test_the_far_side_shows_from_the_side(space: VoxelMap) -> None:
    here = space.march(Pose2(), EYE, 2.0).count_met(space.may_hold_more)
    beside = space.march(Pose2(1.2, -1.2, math.pi / 2), EYE, 2.0).count_met(space.may_hold_more)
    assert beside > here


def test_patches_lie_on_the_box_and_face_the_robot(box: Session) -> None:
    patches = extract_view_patches(box.views[0], box.workspace)
    assert extract_view_patches(box.views[0], box.workspace) is patches
    other = replace(box.views[0], target=box.views[0].target.select(np.arange(2000)))
    assert len(extract_view_patches(other, box.workspace)) < len(patches)
    front = np.abs(patches.points[:, 0] - 0.9) < 0.03
    assert np.mean(front) > 0.8
    inner = (
        front & (np.abs(patches.points[:, 1]) < 0.2) & (np.abs(patches.points[:, 2] - 0.3) < 0.2)
    )
    assert np.all(patches.normals[inner, 0] < -0.95)
    assert np.all(patches.variation[inner] < 0.03)


def test_what_faces_away_or_is_hidden_is_not_seen() -> None:
    y, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.3, 0.3, 16), np.linspace(0.1, 0.5, 11)))
    front = np.column_stack([np.full(len(y), 1.0), y, z])
    back = front + np.array([0.5, 0.0, 0.0])
    normals = np.tile([-1.0, 0.0, 0.0], (len(y), 1))
    both = Patches(np.concatenate([front, back]), np.tile(normals, (2, 1)), np.zeros(2 * len(y)))
    seen = EYE.sees(Pose2(), both)
    assert np.all(seen[: len(y)])
    assert not np.any(seen[len(y) :])
    assert not np.any(EYE.sees(Pose2(3.0, 0.0, math.pi), both))
    assert not np.any(EYE.sees(Pose2(0.0, 0.0, math.pi / 2), both))
    alone = Patches(back, normals, np.zeros(len(y)))
    assert np.all(EYE.sees(Pose2(), alone))
    assert not np.any(EYE.sees(Pose2(), alone, occluders=front))


def test_patches_of_several_views_are_counted_once(box: Session) -> None:
    twice = session_at(BOX, poses=(Pose2(), Pose2(0.0, 0.01, 0.0)), half=0.3)
    assert len(merge_patches(twice)) < 1.6 * len(merge_patches(box))


def test_too_few_points_make_no_patches() -> None:
    assert len(extract_patches(np.zeros((5, 3)), np.zeros(3))) == 0
    assert EYE.sees(Pose2(), extract_patches(np.zeros((5, 3)), np.zeros(3))).shape == (0,)


def test_the_eye_is_that_of_the_sweeps(box: Session) -> None:
    eye = Eye.of(box.views[0], paper_config())
    assert eye.height == pytest.approx(0.30)
    assert eye.half_width == pytest.approx(math.radians(30.0))


@pytest.mark.parametrize("shift", [synthetic.interleaved, synthetic.irregular])
def test_a_beam_has_passed_what_is_before_its_reading_wherever_it_lies(
    shift: synthetic.Shift,
) -> None:
    image = synthetic.observe(Pose2(), shift=shift).image
    lines, beams = np.nonzero(np.isfinite(image.ranges) & (image.ranges < 3.9))
    low = np.abs(image.elevations_at(lines, beams)) < 1.0
    lines, beams = lines[low], beams[low]
    nearer = replace(image, ranges=read_only(image.ranges - 0.03))
    assert np.mean(is_passed(nearer.points_at(lines, beams), image, 0.02)) > 0.995
    assert np.mean(is_passed(nearer.points_at(lines, beams), image, 0.04)) < 0.02
