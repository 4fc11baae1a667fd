"""``ViewPlanOverlap-v0``: choose the overlap with the previous view, the paper's decision."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from scan3d_twin.core.planning.context import Placement, to_world
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.base import Mask, Observation, ViewPlanEnv

OVERLAPS = tuple(round(0.20 + 0.05 * k, 2) for k in range(13))
"""Overlaps of the actions; 0.20 and 0.80 are the paper's limits."""


class OverlapEnv(ViewPlanEnv[np.int64]):
    """Choose the overlap eta; the geometry of the paper's Fig. 8 gives the viewpoint.

    If a viewpoint is not free, the nearest free one along the standoff replaces it, as with the
    planners. The action mask excludes overlaps without any; a masked action is replaced by the
    nearest overlap that has a viewpoint.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.action_space = spaces.Discrete(len(OVERLAPS))
        self._placements: list[Placement] = []

    def extra_spaces(self) -> dict[str, spaces.Space[Any]]:
        """See ``ViewPlanEnv``."""
        return {"action_mask": spaces.MultiBinary(len(OVERLAPS))}

    def extra_observation(self) -> Observation:
        """See ``ViewPlanEnv``."""
        return {"action_mask": self.action_masks().astype(np.int8)}

    def action_masks(self) -> Mask:
        """Return the action mask (13,) in the form that sb3-contrib expects: 1 where feasible."""
        return np.array([p.viewpoint is not None for p in self._placements], dtype=np.int8)

    def update_actions(self) -> bool:
        """See ``ViewPlanEnv``; takes a panorama if no overlap has its own viewpoint."""
        if not self.episode.sees_target:
            self._placements = [Placement(None, False)] * len(OVERLAPS)
            return False
        self._placements = self._place_viewpoints()
        if not any(placement.is_wanted for placement in self._placements):
            self.episode.look()
            self._placements = self._place_viewpoints()
        return any(placement.viewpoint is not None for placement in self._placements)

    def _place_viewpoints(self) -> list[Placement]:
        context = self.episode.context
        return [context.find_placement(eta) for eta in OVERLAPS]

    def plan_of_action(self, action: np.int64) -> tuple[Plan, bool]:
        """See ``ViewPlanEnv``."""
        free = np.flatnonzero(self.action_masks())
        index = int(free[np.argmin(np.abs(free - int(action)))])
        viewpoint = self._placements[index].viewpoint
        if viewpoint is None:
            raise ValueError("no overlap has a viewpoint, but the episode was not truncated")
        pose = to_world(self.episode.context, viewpoint)
        reason = f"action {int(action)}: overlap {OVERLAPS[index]:.0%}"
        return Plan(pose, OVERLAPS[index], math.nan, False, (), reason), index != int(action)

    def action_of_plan(self, plan: Plan) -> np.int64:
        """See ``ViewPlanEnv``."""
        return np.int64(np.argmin(np.abs(np.array(OVERLAPS) - plan.overlap)))

    def _info(self, terms: dict[str, float], overlap: float) -> dict[str, Any]:
        return {**super()._info(terms, overlap), "action_mask": self.action_masks()}
