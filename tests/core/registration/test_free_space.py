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
