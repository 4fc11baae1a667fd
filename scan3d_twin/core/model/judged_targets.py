"""The targets of the truth by which a session is judged: the scanned ones, or the one asked for."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scan3d_twin.core.model.pose_errors import lay_on_truth
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2

TARGET_SPACING = 0.02
"""Spacing of the samples that tell which targets are one thing to the robot [m]."""
MIN_HINT_SHARE = 0.1
"""Least share of the panorama's points of the target that a target holds which was scanned."""
HINT_DISTANCE = 0.3
"""Distance from the target within which the panorama's points of it are [m]: lines 2 deg apart and
odometry."""


def find_judged_targets(session: Session, truth: Truth, asked: str = "") -> tuple[str, ...]:
    """Return the names of the targets by which ``session`` is judged.

    See ``evaluation.Reference.of``.
    """
    names = truth.targets
    if len(names) < 2:
        return names

    # Find the targets that were asked for or seen
    trees = {name: Tree.of(truth.surface(TARGET_SPACING, [name])[0][:, :2]) for name in names}
    chosen = (
        [asked] if asked in names else _find_hinted(trees, lay_on_truth(session, truth), session)
    )
    if not chosen:
        return names

    # Add those that are one thing with them
    reach, gap = list(chosen), session.config.target.cluster_gap
    while reach:
        tree = trees[reach.pop()]
        for name in names:
            if name not in chosen and np.any(tree.is_near(trees[name].points, gap)):
                chosen.append(name)
                reach.append(name)
    return tuple(name for name in names if name in chosen)


def is_of_target(session: Session, truth: Truth, asked: str = "") -> bool:
    """Return whether ``session`` is of the target of ``truth``, and not of another thing.

    Most of the panorama's points are on it; of a target that was ``asked`` for by name, which may
    be a part of what the robot takes for one thing, ``MIN_HINT_SHARE`` of them are.
    """
    named = asked in truth.targets
    surface, _ = truth.surface(HINT_DISTANCE, [asked] if named else None)
    hint = lay_on_truth(session, truth).apply(session.hint)
    distances = Tree.of(surface[:, :2]).closest(hint)[0]
    return bool(np.quantile(distances, MIN_HINT_SHARE if named else 0.5) <= HINT_DISTANCE)


def _find_hinted(trees: Mapping[str, Tree], T_map_world: Pose2, session: Session) -> list[str]:
    """Return the names of the targets that the panorama's points of the target are on."""
    hint = T_map_world.apply(session.hint)
    distances = np.stack([tree.closest(hint)[0] for tree in trees.values()])
    nearest = np.where(distances.min(axis=0) <= HINT_DISTANCE, distances.argmin(axis=0), -1)
    return [name for k, name in enumerate(trees) if np.mean(nearest == k) >= MIN_HINT_SHARE]
