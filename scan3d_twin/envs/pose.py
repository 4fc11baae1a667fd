"""``ViewPlanPose-v0``: choose any pose around the target; it is snapped to a reachable place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from scan3d_twin.core.navigation.costmap import RESOLUTION
from scan3d_twin.core.planning.context import explain_view_limit
from scan3d_twin.core.types import FloatArray, Plan, Pose2, wrap
from scan3d_twin.envs.base import ViewPlanEnv

REACH = 3.0
"""Largest offset from the middle of the target along x and y of ``world`` [m]."""
PoseAction = npt.NDArray[np.float32]


class PoseEnv(ViewPlanEnv[PoseAction]):
    """Choose x, y and heading, each in -1..1: x and y per 3 m about the target, heading per pi.

    The position is snapped to the nearest cell of the costmap that the robot can reach.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._places: FloatArray = np.zeros((0, 2))

    def update_actions(self) -> bool:
        """See ``ViewPlanEnv``; takes a panorama if the robot can reach no other cell."""
        self._places = self._reachable()
        if len(self._places) < 2:
            self.episode.look()
            self._places = self._reachable()
        return len(self._places) > 1

    def _reachable(self) -> FloatArray:
        """Return the centres (n, 2) in ``odom`` [m] of the cells that the robot can reach."""
        costmap = self.episode.costmap
        cells = np.argwhere(costmap.passable)
        places = np.asarray(costmap.origin + (cells + 0.5) * RESOLUTION)
        return places[np.isfinite(costmap.path_lengths(places))]

    def completion_reason(self) -> str | None:
        """See ``ViewPlanEnv``; only ``max_views`` counts, since a pose may face away."""
        return explain_view_limit(self.session)

    def plan_of_action(self, action: PoseAction) -> tuple[Plan, bool]:
        """See ``ViewPlanEnv``."""
        x, y = self.session.hint.mean(axis=0) + REACH * action[:2].astype(np.float64)
        wanted = self._odom_of_world @ Pose2(float(x), float(y), math.pi * float(action[2]))
        away = np.hypot(*(self._places - (wanted.x, wanted.y)).T)
        place = self._places[int(np.argmin(away))]
        there = self._odom_of_world.inverse() @ Pose2(float(place[0]), float(place[1]), wanted.yaw)
        snapped = bool(away.min() > RESOLUTION)
        return Plan(there, 0.0, math.nan, False, (), "action: a pose"), snapped

    def action_of_plan(self, plan: Plan) -> PoseAction:
        """See ``ViewPlanEnv``."""
        pose = plan.viewpoint or self.session.views[-1].T_world_scan
        off = (np.array([pose.x, pose.y]) - self.session.hint.mean(axis=0)) / REACH
        values = np.clip([*off, wrap(pose.yaw) / math.pi], -1.0, 1.0)
        return np.asarray(values, dtype=np.float32)

    @property
    def _odom_of_world(self) -> Pose2:
        view = self.session.views[-1]
        return view.observation.T_odom_scan @ view.T_world_scan.inverse()
