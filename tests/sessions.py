"""Test helper: small sessions without a simulator: a panorama and views of boxes ahead."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Plan, Pose2

WALL = (Box((1.0, -5.0, 0.0), (1.2, 5.0, 1.5)),)
PILASTERS = tuple(
    Box((1.0 + 0.08 * (k % 2), 1.0 - 0.2 * (k + 1), 0.0), (1.4, 1.0 - 0.2 * k, 1.0))
    for k in range(20)
)
"""A wall with pilasters every 0.2 m: full of edges."""
BOX = (Box((0.9, -0.3, 0.0), (1.5, 0.3, 0.6)),)
"""A free-standing box, seen from its front alone."""


def session_at(
    boxes: tuple[Box, ...],
    config: Config | None = None,
    *,
    poses: tuple[Pose2, ...] = (Pose2(),),
    half: float = 1.0,
    sigma: float = 0.004,
    seed: int = 4,
) -> Session:
    """Return a session with a panorama from the origin and a view from each pose.

    Args:
        boxes: What there is.
        config: The effective configuration.
        poses: Where the sweeps are taken, known without error.
        half: The target is known from y = -half to half at x = 1 [m].
        sigma: Range noise [m].
        seed: Of the noise.
    """
    config = config or paper_config()
    rng = np.random.default_rng(seed)
    around = observe(Pose2(), boxes, room=False, width=math.tau - 1e-3, step=math.radians(2.0))
    hint = np.column_stack([np.full(41, 1.0), np.linspace(half, -half, 41)])
    looks = ((0, around), (len(poses), around))
    session = Session(config, 0, hint, np.array([-1.0, 0.0]), looks)
    for pose in poses:
        view = observe(pose, boxes, room=False, sigma=sigma, rng=rng)
        session = integrate(session, Observation(view.image, pose))
    return session


def with_baselines(session: Session, **changes: object) -> Session:
    """Return ``session`` with other options for the baselines."""
    baselines = replace(session.config.baselines, **changes)  # type: ignore[arg-type]
    return replace(session, config=replace(session.config, baselines=baselines))


def two_planned_views() -> Session:
    """Two views of three boxes in closed form; the second planned without a prediction."""
    hint = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])
    session = Session(paper_config(), 7, hint, np.array([-1.0, 0.0]))
    for y in (0.2, 0.0):
        session = integrate(session, observe(Pose2(-0.4, y, 0.0)))
        plan = Plan(Pose2(-0.4, 0.0, 0.0), 0.8, math.nan, True, (), "the default")
        session = session.with_plan(plan)
    return session.with_stop_reason("enough")
