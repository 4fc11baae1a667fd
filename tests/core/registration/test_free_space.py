"""What free space says of the pose of two sweeps."""

from __future__ import annotations

import math

import numpy as np
import synthetic

from scan3d_twin.core.registration.surfels.free_space import (
    MAX_CONTRADICTION,
    find_contradicted_share,
    measure_contradiction,
)
from scan3d_twin.core.registration.surfels.grid import SurfelGrid, extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise
from scan3d_twin.core.types import Pose2

HALL = (synthetic.Box((3.2, -6.0, 0.0), (3.4, 6.0, 2.5)),)
"""A wall that goes on beyond the range of the lidar, 4 m."""
SIGMA = 0.005


def take(pose: Pose2, seed: int) -> SurfelGrid:
    rng = np.random.default_rng(seed)
    image = synthetic.observe(
        pose, HALL, room=False, width=math.radians(150.0), sigma=SIGMA, rng=rng
    ).image
    with np.errstate(invalid="ignore"):
        return extract_surfels(image, keep=image.points[..., 2] > 0.03, noise=ScanNoise(SIGMA))


def test_what_is_out_of_range_contradicts_nothing() -> None:
    """From 1 m nearer more of a long wall is in range: it has not come there."""
    move = Pose2(1.0, 0.0, 0.1)
    target, source = take(Pose2(), 1), take(move, 2)
    T = move.matrix()
    assert measure_contradiction(target, source, T, 4) < 0.01
    assert find_contradicted_share(target, source, T, 4) == 0.0

    # A place within range does, where the other sweep saw the wall behind it
    nearer = Pose2(move.x - 0.1, move.y, move.yaw).matrix()
    assert measure_contradiction(target, source, nearer, 4) > 0.15
    assert find_contradicted_share(target, source, nearer, 4) > 10 * MAX_CONTRADICTION


def test_what_stands_beside_the_last_line_contradicts_nothing() -> None:
    """Lines 2 deg apart, as of a base that turns quickly, stand for 7 cm at 2 m."""
    beside = synthetic.Box((1.4, 0.02, 0.0), (2.6, 0.3, 2.5))  # along the last ray to the left
    boxes = (synthetic.Box((2.6, -3.0, 0.0), (2.8, 0.02, 2.5)), beside)
    poses = Pose2(0.0, 0.0, math.radians(-30.0)), Pose2(1.2, -1.2, math.radians(60.0))
    target, source = (
        extract_surfels(
            synthetic.observe(
                pose, boxes, room=False, width=math.radians(60.0), step=math.radians(2.0)
            ).image,
            noise=ScanNoise(SIGMA),
        )
        for pose in poses
    )
    T = np.linalg.inv(poses[0].matrix()) @ poses[1].matrix()
    assert find_contradicted_share(target, source, T, 1) < 0.1 * MAX_CONTRADICTION

    # Where lines on both sides saw through, it does
    turned = T.copy()
    turned[:2, 3] += 0.2 * np.array([math.sin(math.radians(-30.0)), -math.cos(math.radians(-30.0))])
    assert find_contradicted_share(target, source, turned, 1) > MAX_CONTRADICTION
