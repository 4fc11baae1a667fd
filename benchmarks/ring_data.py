"""Sweeps around a target with known poses, for ``ring.py`` and pictures of the documentation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from registration_data import FloatArray, Noise, Scene, box, merge, polygon, scan

from scan3d_twin.core.types import Pose2, RangeImage

SIGMA_XY, SIGMA_YAW = 0.02, math.radians(2.0)
RADIUS, HALF = 1.2, 42.0
"""Distance of the views from the target's middle [m], and half the width of their sweeps [deg]."""


def cabinet() -> Scene:
    """Return a body with a wavy front, a notch behind, and a lower box at its side."""
    y = np.linspace(0.3, -0.3, 121)
    front = np.stack([-0.25 + 0.02 * np.sin(math.tau * y / 0.15), y], axis=1)
    back = np.array(
        [[0.25, -0.3], [0.25, 0.05], [0.20, 0.05], [0.20, 0.11], [0.25, 0.11], [0.25, 0.3]]
    )
    return merge(polygon(np.concatenate([front, back]), 0.6), box(0.05, 0.42, 0.25, 0.2, 0.35, -20))


def three_boxes() -> Scene:
    """Return three boxes side by side, free-standing."""
    return merge(
        box(0.0, 0.35, 0.3, 0.4, 0.5, 0),
        box(0.1, -0.05, 0.3, 0.35, 0.4, 8),
        box(-0.05, -0.45, 0.3, 0.45, 0.6, -5),
    )


TARGETS = {"cabinet": cabinet, "three_boxes": three_boxes}
NOISES = (0.010, 0.003)


@dataclass(frozen=True)
class Ring:
    """Sweeps around a target, their true poses from the first, and the moves by odometry."""

    images: list[RangeImage]
    truth: list[Pose2]
    moves: list[Pose2]

    def error(self, poses: list[Pose2]) -> float:
        """Return the RMS error of the model [m]."""
        squares = [
            np.sum((true.apply(points) - pose.apply(points)) ** 2, axis=1)
            for points, true, pose in zip(self.clouds(), self.truth, poses, strict=True)
        ]
        return float(np.sqrt(np.mean(np.concatenate(squares))))

    def clouds(self) -> list[FloatArray]:
        """Return the points of each sweep (n, 3) [m]."""
        return [
            np.ascontiguousarray(image.points[np.isfinite(image.ranges)]) for image in self.images
        ]


def make_ring(target: str, sigma: float, seed: int, views: int) -> Ring:
    rng = np.random.default_rng([seed, views])
    angles = math.tau * np.arange(views) / views
    poses = [Pose2(RADIUS * math.cos(a), RADIUS * math.sin(a), a + math.pi) for a in angles]
    images = [scan(TARGETS[target](), pose, HALF, Noise(sigma), rng) for pose in poses]
    moves = []
    for before, after in pairwise(poses):
        move = before.inverse() @ after
        x, y, yaw = rng.standard_normal(3) * [SIGMA_XY, SIGMA_XY, SIGMA_YAW]
        moves.append(Pose2(move.x + x, move.y + y, move.yaw + yaw))
    return Ring(images, [poses[0].inverse() @ pose for pose in poses], moves)


def chain(moves: list[Pose2]) -> list[Pose2]:
    poses = [Pose2()]
    for move in moves:
        poses.append(poses[-1] @ move)
    return poses
