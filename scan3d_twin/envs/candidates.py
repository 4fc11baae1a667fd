"""``Candidates-v0``: choose one of 21 candidate viewpoints, with an action mask."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from scan3d_twin.core.planning.context import to_world
from scan3d_twin.core.types import Candidate, Plan, Pose2, wrap
from scan3d_twin.envs.base import Mask, Observation, ViewPlanEnv
from scan3d_twin.envs.observations import POSITION_SCALE

OVERLAPS = tuple(round(0.20 + 0.10 * k, 1) for k in range(7))
"""Overlaps of the candidates, as in the paper."""
BEARING_OFFSETS = tuple(math.radians(angle) for angle in (0.0, 20.0, -20.0))
"""Bearings of the candidates off the normal of the next segment [rad]; readings become unreliable
only beyond 65 deg."""
N_CANDIDATES = len(OVERLAPS) * len(BEARING_OFFSETS)


class CandidatesEnv(ViewPlanEnv[np.int64]):
    """Choose one of 21 viewpoints: 7 overlaps, each straight ahead and from 20 deg to either side.

    The action mask excludes candidates that cannot be reached; a masked action is replaced by the
    nearest candidate that can.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.action_space = spaces.Discrete(N_CANDIDATES)
        self._candidates: tuple[Candidate, ...] = ()

    def extra_spaces(self) -> dict[str, spaces.Space[Any]]:
        """See ``ViewPlanEnv``: x, y, cos and sin of the heading, and overlap of each candidate."""
        return {
            "candidates": spaces.Box(-1.0, 1.0, (5 * N_CANDIDATES,), np.float32),
            "action_mask": spaces.MultiBinary(N_CANDIDATES),
        }

    def extra_observation(self) -> Observation:
        """See ``ViewPlanEnv``; infeasible candidates are all zeros."""
        rows = np.zeros((N_CANDIDATES, 5))
        for row, candidate in zip(rows, self._candidates, strict=True):
            if candidate.feasible:
                pose = candidate.viewpoint
                row[:] = (
                    pose.x / POSITION_SCALE, pose.y / POSITION_SCALE,
                    math.cos(pose.yaw), math.sin(pose.yaw), candidate.overlap,
                )  # fmt: skip
        return {
            "candidates": np.clip(rows, -1.0, 1.0).astype(np.float32).ravel(),
            "action_mask": self.action_masks().astype(np.int8),
        }

    def action_masks(self) -> Mask:
        """Return the action mask (21,) in the form that sb3-contrib expects: 1 where feasible."""
        return np.array([candidate.feasible for candidate in self._candidates], dtype=np.int8)

    def update_actions(self) -> bool:
        """See ``ViewPlanEnv``; takes a panorama if no candidate is feasible."""
        if not self.episode.sees_target:
            self._candidates = (Candidate(Pose2(), 0.0, math.nan, False),) * N_CANDIDATES
            return False
        self._candidates = self._generate_candidates()
        if not self.action_masks().any():
            self.episode.look()
            self._candidates = self._generate_candidates()
        return bool(self.action_masks().any())

    def _generate_candidates(self) -> tuple[Candidate, ...]:
        """Return the candidates in frame ``scan`` of the latest view."""
        context, offered = self.episode.context, []
        standoff = self.session.config.planning.standoff
        for eta in OVERLAPS:
            place = context.find_placement(eta).viewpoint
            for turn in BEARING_OFFSETS:
                pose = Pose2() if place is None else _rotate_about_target(place, standoff, turn)
                feasible = place is not None and context.is_feasible(pose)
                offered.append(Candidate(pose, eta, math.nan, feasible))
        return tuple(offered)

    def plan_of_action(self, action: np.int64) -> tuple[Plan, bool]:
        """See ``ViewPlanEnv``."""
        wanted = self._candidates[int(action)].viewpoint
        index, free = int(action), np.flatnonzero(self.action_masks()).tolist()
        if index not in free:
            index = min(free, key=lambda k: self._candidates[k].viewpoint.distance(wanted))
        chosen = self._candidates[index]
        pose = to_world(self.episode.context, chosen.viewpoint)
        reason = f"action {int(action)}: candidate {index}"
        return Plan(pose, chosen.overlap, math.nan, False, (), reason), index != int(action)

    def action_of_plan(self, plan: Plan) -> np.int64:
        """See ``ViewPlanEnv``: the feasible candidate nearest in place, then in heading."""
        pose = plan.viewpoint or self.session.views[-1].T_world_scan
        local = self.session.views[-1].T_world_scan.inverse() @ pose

        def off(k: int) -> float:
            there = self._candidates[k].viewpoint
            return there.distance(local) + abs(wrap(there.yaw - local.yaw))

        return np.int64(min(np.flatnonzero(self.action_masks()).tolist(), key=off))

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        return {**super()._info(terms, overlap), "action_mask": self.action_masks()}


def _rotate_about_target(viewpoint: Pose2, standoff: float, turn: float) -> Pose2:
    """Return ``viewpoint`` rotated by ``turn`` [rad] about the point ``standoff`` [m] ahead."""
    middle = viewpoint @ Pose2(standoff, 0.0, 0.0)
    return middle @ Pose2(0.0, 0.0, turn) @ Pose2(-standoff, 0.0, 0.0)
