"""``ViewPlanOverlap-v0``: the paper's decision, the overlap with what was just seen."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from scan3d_twin.core.planning.context import Placement, to_world
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.base import Mask, Observation, ViewPlanEnv

ETAS = tuple(round(0.20 + 0.05 * k, 2) for k in range(13))
"""The overlaps that can be chosen; 0.20 and 0.80 are the paper's limits."""


class OverlapEnv(ViewPlanEnv[np.int64]):
    """Choose eta; where the robot stands for it is the geometry of the paper's Fig. 8.

    Where a viewpoint is not free, the nearest free one along the standoff takes its place, as with
    the planners. An overlap without any is masked; taken all the same, it is the nearest one that
    has a viewpoint.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.action_space = spaces.Discrete(len(ETAS))
        self._placements: list[Placement] = []

    def own_space(self) -> dict[str, spaces.Space[Any]]:
        """See ``ViewPlanEnv``."""
        return {"action_mask": spaces.MultiBinary(len(ETAS))}

    def own_values(self) -> Observation:
        """See ``ViewPlanEnv``."""
        return {"action_mask": self.action_masks().astype(np.int8)}

    def action_masks(self) -> Mask:
        """Return which overlaps have a viewpoint (13,), as sb3-contrib asks for it."""
        return np.array([p.viewpoint is not None for p in self._placements], dtype=np.int8)

    def prepare(self) -> bool:
        """See ``ViewPlanEnv``; looks around when no overlap has the viewpoint it wants."""
        if not self.episode.sees_target:
            self._placements = [Placement(None, False)] * len(ETAS)
            return False
        self._placements = self._place()
        if not any(placement.is_wanted for placement in self._placements):
            self.episode.look()
            self._placements = self._place()
        return any(placement.viewpoint is not None for placement in self._placements)

    def _place(self) -> list[Placement]:
        context = self.episode.context
        return [context.find_placement(eta) for eta in ETAS]

    def decode(self, action: np.int64) -> tuple[Plan, bool]:
        """See ``ViewPlanEnv``."""
        free = np.flatnonzero(self.action_masks())
        index = int(free[np.argmin(np.abs(free - int(action)))])
        viewpoint = self._placements[index].viewpoint
        if viewpoint is None:
            raise ValueError("the episode goes on without a viewpoint")
        pose = to_world(self.episode.context, viewpoint)
        reason = f"action {int(action)}: overlap {ETAS[index]:.0%}"
        return Plan(pose, ETAS[index], math.nan, False, (), reason), index != int(action)

    def encode(self, plan: Plan) -> np.int64:
        """See ``ViewPlanEnv``."""
        return np.int64(np.argmin(np.abs(np.array(ETAS) - plan.overlap)))

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        return {**super()._info(terms, overlap), "action_mask": self.action_masks()}
