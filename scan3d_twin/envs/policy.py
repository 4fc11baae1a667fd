"""Planners as policies: the action that a planner would take in an environment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium

from scan3d_twin.core.digitize import ask_planner
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.planning import Planner, make_planner
from scan3d_twin.core.types import Plan
from scan3d_twin.envs.base import ViewPlanEnv


class PlannerPolicy:
    """A planner as a policy.

    It gets the session of the episode and the random numbers that ``digitize`` would give it. In
    ``ViewPlanOverlap-v0`` a planner that chooses overlaps acts exactly as in ``digitize``; in other
    environments it takes the action nearest to its plan.

    >>> import gymnasium
    >>> env = gymnasium.make(
    ...     "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0", fidelity="kinematic"
    ... )
    >>> _ = env.reset(seed=0)
    >>> action = s3d.PlannerPolicy("fixed50").act(env)
    >>> int(action)
    6
    """

    def __init__(self, planner: Planner | str) -> None:
        """Use a planner, or the one of a name from ``list_planners``."""
        self._planner = make_planner(planner) if isinstance(planner, str) else planner

    def act(self, env: gymnasium.Env[Any, Any]) -> Any:
        """Return the planner's action in ``env``, or None if it considers the scan finished."""
        inner = _unwrap(env)
        plan = self.plan(inner)
        return None if plan.viewpoint is None else inner.action_of_plan(plan)

    def plan(self, env: ViewPlanEnv[Any]) -> Plan:
        """Return the planner's plan; take a panorama first if it needs one."""
        plan = ask_planner(self._planner, env.session)
        if plan.needs_panorama:
            env.look()
            plan = ask_planner(self._planner, env.session)
        return plan


@dataclass(frozen=True)
class Rollout:
    """Result of one episode.

    Attributes:
        total: Sum of the rewards.
        info: Info of the last step.
        rewards: Reward of each step.
    """

    total: float
    info: dict[str, Any]
    rewards: tuple[float, ...]


def rollout(
    env: gymnasium.Env[Any, Any], policy: PlannerPolicy, seed: int | None = None
) -> Rollout:
    """Return the result of one episode of ``env`` with ``policy``.

    >>> import gymnasium
    >>> env = gymnasium.make(
    ...     "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0", fidelity="kinematic"
    ... )
    >>> result = s3d.rollout(env, s3d.PlannerPolicy("fixed50"), seed=0)
    >>> result.total == sum(result.rewards), result.info["views"] == len(result.rewards) + 1
    (True, True)
    """
    _, info = env.reset(seed=seed)
    rewards: list[float] = []
    over = False
    while not over:
        action = policy.act(env)
        if action is None:
            break
        _, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        over = terminated or truncated
    return Rollout(sum(rewards), info, tuple(rewards))


def _unwrap(env: gymnasium.Env[Any, Any]) -> ViewPlanEnv[Any]:
    inner = env.unwrapped
    if not isinstance(inner, ViewPlanEnv):
        raise ConfigError(f"planners act in the environments of scan3d_twin.envs, not in {inner}")
    return inner
