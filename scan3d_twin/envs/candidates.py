"""``Candidates-v0``: choose among feasible viewpoints, each described by what the robot knows."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from scan3d_twin.core.planning.context import to_world
from scan3d_twin.core.types import Candidate, Plan, Pose2, wrap
from scan3d_twin.envs.base import Mask, Observation, ViewPlanEnv
from scan3d_twin.envs.observations import FAR

ETAS = tuple(round(0.20 + 0.10 * k, 1) for k in range(7))
"""Overlaps of the candidates; the paper's."""
TURNS = tuple(math.radians(angle) for angle in (0.0, 20.0, -20.0))
"""Off the normal of the next segment; less than the 65 deg beyond which readings go wrong."""
K = len(ETAS) * len(TURNS)


class CandidatesEnv(ViewPlanEnv[np.int64]):
    """Choose one of 21 viewpoints: 7 overlaps, each straight ahead and from 20 deg to either side.

    A candidate that cannot be reached is masked; taken all the same, it is the nearest that can.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.action_space = spaces.Discrete(K)
        self._candidates: tuple[Candidate, ...] = ()

    def own_space(self) -> dict[str, spaces.Space[Any]]:
        """See ``ViewPlanEnv``: per candidate x, y, cos and sin of the heading, overlap."""
        return {
            "candidates": spaces.Box(-1.0, 1.0, (5 * K,), np.float32),
            "action_mask": spaces.MultiBinary(K),
        }

    def own_values(self) -> Observation:
        """See ``ViewPlanEnv``; what is not feasible is all zeros."""
        rows = np.zeros((K, 5))
        for row, candidate in zip(rows, self._candidates, strict=True):
            if candidate.feasible:
                pose = candidate.viewpoint
                row[:] = (
                    pose.x / FAR, pose.y / FAR, math.cos(pose.yaw), math.sin(pose.yaw),
                    candidate.overlap,
                )  # fmt: skip
        return {
            "candidates": np.clip(rows, -1.0, 1.0).astype(np.float32).ravel(),
            "action_mask": self.action_masks().astype(np.int8),
        }

    def action_masks(self) -> Mask:
        """Return which candidates are feasible (21,), as sb3-contrib asks for it."""
        return np.array([candidate.feasible for candidate in self._candidates], dtype=np.int8)

    def prepare(self) -> bool:
        """See ``ViewPlanEnv``; looks around when nothing is feasible."""
        if not self.episode.sees_target:
            self._candidates = (Candidate(Pose2(), 0.0, math.nan, False),) * K
            return False
        self._candidates = self._offer()
        if not self.action_masks().any():
            self.episode.look()
            self._candidates = self._offer()
        return bool(self.action_masks().any())

    def _offer(self) -> tuple[Candidate, ...]:
        """Return the candidates in frame ``scan`` of the latest view."""
        context, offered = self.episode.context, []
        standoff = self.session.config.planning.standoff
        for eta in ETAS:
            place = context.find_placement(eta).viewpoint
            for turn in TURNS:
                pose = Pose2() if place is None else _turned(place, standoff, turn)
                feasible = place is not None and context.is_feasible(pose)
                offered.append(Candidate(pose, eta, math.nan, feasible))
        return tuple(offered)

    def decode(self, action: np.int64) -> tuple[Plan, bool]:
        """See ``ViewPlanEnv``."""
        wanted = self._candidates[int(action)].viewpoint
        index, free = int(action), np.flatnonzero(self.action_masks()).tolist()
        if index not in free:
            index = min(free, key=lambda k: self._candidates[k].viewpoint.distance(wanted))
        chosen = self._candidates[index]
        pose = to_world(self.episode.context, chosen.viewpoint)
        reason = f"action {int(action)}: candidate {index}"
        return Plan(pose, chosen.overlap, math.nan, False, (), reason), index != int(action)

    def encode(self, plan: Plan) -> np.int64:
        """See ``ViewPlanEnv``: the feasible candidate nearest in place, then in heading."""
        pose = plan.viewpoint or self.session.views[-1].T_world_scan
        local = self.session.views[-1].T_world_scan.inverse() @ pose

        def off(k: int) -> float:
            there = self._candidates[k].viewpoint
            return there.distance(local) + abs(wrap(there.yaw - local.yaw))

        return np.int64(min(np.flatnonzero(self.action_masks()).tolist(), key=off))

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        return {**super()._info(terms, overlap), "action_mask": self.action_masks()}


def _turned(viewpoint: Pose2, standoff: float, turn: float) -> Pose2:
    """Return ``viewpoint`` turned by ``turn`` [rad] about what it looks at, ``standoff`` ahead."""
    middle = viewpoint @ Pose2(standoff, 0.0, 0.0)
    return middle @ Pose2(0.0, 0.0, turn) @ Pose2(-standoff, 0.0, 0.0)
