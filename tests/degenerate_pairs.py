"""Sweeps of a turned lidar that do not determine the pose: the cases of ``cloud_scenes``.

A vertical lidar with 213 beams of 0.35 deg and a line every half degree, 0.3 m up on the yaw axis,
sees the scene with 5 mm noise, in whole millimetres, up to 4 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cloud_scenes
import numpy as np
import synthetic

from scan3d_twin.core.types import VALID, FloatArray, Pose2, RangeImage, read_only

CASES = (*cloud_scenes.DEGENERATE, "disjoint", "identical")
SIGMA, REACH, LINE_STEP = 0.005, 4.0, math.radians(0.5)
MOUNT = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]])
PRIOR_XY, PRIOR_YAW = 0.03, math.radians(1.7)
"""Standard deviations of the guesses, and of the priors that say so [m, rad]."""


@dataclass(frozen=True)
class SweepPair:
    """Two sweeps, the true and the guessed pose of the second in the first.

    Attributes:
        target: First sweep.
        source: Second sweep.
        truth: ``T_target_source``.
        init: The guess, off by a draw of the prior.
        directions: What the scene leaves undetermined about the target's origin (k, 6).
    """

    target: RangeImage
    source: RangeImage
    truth: Pose2
    init: Pose2
    directions: FloatArray


def draw_pair(name: str, seed: int) -> SweepPair:
    """Return a pair of a degenerate case.

    ``disjoint`` looks to both sides of a room; ``identical`` is one sweep of it twice.
    """
    rng = np.random.default_rng([seed, 18])
    width = math.tau if "corridor" in name else math.radians(150.0)
    first = Pose2(0.0, 0.0, rng.uniform(-0.2, 0.2))
    move = Pose2(rng.uniform(-0.1, 0.1), rng.uniform(-0.3, 0.3), rng.uniform(-0.15, 0.15))
    off = rng.standard_normal(3) * (PRIOR_XY, PRIOR_XY, PRIOR_YAW)

    # Scene and poses
    case = cloud_scenes.DEGENERATE.get(name)
    if case is None:
        case = cloud_scenes.DegenerateCase(cloud_scenes.random_scene(rng).bodies)
    if name == "disjoint":
        move = Pose2(0.0, 0.0, math.pi)
    target = sweep(case.bodies, first, width, rng)
    source = target if name == "identical" else sweep(case.bodies, first @ move, width, rng)
    truth = Pose2() if name == "identical" else move
    guess = Pose2() if name == "disjoint" else truth
    init = Pose2(guess.x + off[0], guess.y + off[1], guess.yaw + off[2])
    return SweepPair(target, source, truth, init, case.directions(first.matrix(), "planar"))


def sweep(
    bodies: tuple[cloud_scenes.Body, ...], pose: Pose2, width: float, rng: np.random.Generator
) -> RangeImage:
    """Return what the lidar sees from ``pose``."""
    image = synthetic.observe(
        Pose2(), (), room=False, width=width, step=LINE_STEP, lidar=synthetic.spec(213)
    ).image
    image = replace(image, T_base_lidar=read_only(MOUNT))

    # Cast all rays, which begin at one point
    rays = pose.rotate(image.directions).reshape(-1, 3)
    eye = pose.apply(MOUNT[:3, 3][None])[0]
    near = tuple(b for b in bodies if abs(b.centre[1] - eye[1]) - b.size[1] < REACH)
    ranges = cloud_scenes.cast(near, eye, rays)

    # Add noise
    ranges = np.round(ranges + SIGMA * rng.standard_normal(len(ranges)), 3)
    ranges = np.where((ranges > image.spec.min_range) & (ranges < REACH), ranges, math.nan)
    ranges = ranges.reshape(image.ranges.shape)
    codes = np.where(np.isfinite(ranges), VALID, 0)
    return replace(image, ranges=read_only(ranges), codes=read_only(codes, np.int64))
