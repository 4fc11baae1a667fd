"""A box in a room whose truth is known exactly, and sessions of sweeps of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from paper import paper_config
from synthetic import Box, cast, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Observation, Pose2

BOX = Box((0.6, -0.4, 0.0), (1.0, 0.4, 0.6))
SPAWN = Pose2(-0.9, 0.0, 0.0)
FIRST, SECOND = Pose2(-0.4, 0.3, -0.1), Pose2(-0.4, -0.3, 0.1)
"""True poses of two views, in ``map``; ``odom`` is the same frame here."""


@cache
def headings(pose: Pose2) -> FloatArray:
    """Return the headings (n_lines,) of the lines of a sweep [rad]."""
    return observe(pose, (BOX,)).image.yaws[:, 0]


@dataclass(frozen=True)
class BoxTruth:
    """A box in a room, and a robot that was where the stamps of its sweeps say."""

    poses: tuple[Pose2, ...]
    front: Pose2 | None = None
    spawn: Pose2 = SPAWN

    latest = math.inf
    targets = ("target",)

    def pose_at(self, stamp: float) -> Pose2:
        """Sweep k has stamps from 1000 k on; the robot turned, so add the heading of the line."""
        k, line = divmod(stamp, 1000.0)
        yaws = headings(self.poses[int(k)])
        index = min(int(line / 0.1), len(yaws) - 1)
        return self.poses[int(k)] @ Pose2(0.0, 0.0, float(yaws[index]))

    def poses_at(self, stamps: FloatArray) -> FloatArray:
        """The poses of a sweep's lines."""
        poses = [self.pose_at(stamp) for stamp in stamps.tolist()]
        return np.array([(pose.x, pose.y, pose.yaw) for pose in poses])

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The four sides."""
        points, normals = [], []
        for axis, value, sign in ((0, 0.6, -1), (0, 1.0, 1), (1, -0.4, -1), (1, 0.4, 1)):
            low, high = BOX.low[1 - axis], BOX.high[1 - axis]
            a, z = np.meshgrid(
                np.arange(low, high, spacing) + spacing / 2,
                np.arange(0.0, 0.6, spacing) + spacing / 2,
            )
            side = np.empty((a.size, 3))
            side[:, axis], side[:, 1 - axis], side[:, 2] = value, a.ravel(), z.ravel()
            points.append(side)
            normals.append(np.tile(np.eye(3)[axis] * sign, (len(side), 1)))
        return np.concatenate(points), np.concatenate(normals)

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """The box and the room."""
        return cast(np.asarray(origins), np.asarray(directions), (BOX,), room=True)

    def first_opaque_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Nothing is transparent."""
        return self.first_hits(origins, directions)


def at(pose: Pose2, k: int, sigma: float = 0.0) -> Observation:
    """Return a sweep of the box at ``pose``, stamped for view ``k``."""
    seen = observe(pose, (BOX,), sigma=sigma, rng=np.random.default_rng(k))
    image = replace(seen.image, stamps=seen.image.stamps + 1000.0 * k)
    return Observation(image, pose)


def session_of(*odometry: Pose2, true: tuple[Pose2, ...] = (FIRST, SECOND)) -> Session:
    """Return a session whose views were taken at ``true`` and placed by ``odometry``."""
    hint = np.array([[0.6, 0.0]])
    session = Session(paper_config(tour="full"), 0, hint, np.array([-1.0, 0.0]))
    for k, (measured, pose) in enumerate(zip(odometry, true, strict=False)):
        observation = Observation(at(pose, k).image, measured)
        session = integrate(session, observation)
    return session
