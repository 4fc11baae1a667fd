"""Planners as policies: what the robot's own planner would do in an environment."""

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
    """A planner behind the question "which action now?".

    It sees the session of the episode, as ``digitize`` would show it, and has the same chance. In
    ``ViewPlanOverlap-v0`` a planner that chooses overlaps acts exactly as in ``digitize``;
    elsewhere it takes the action nearest to its plan.

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
        """Take a planner, or the name of one (``list_planners``)."""
        self._planner = make_planner(planner) if isinstance(planner, str) else planner

    def act(self, env: gymnasium.Env[Any, Any]) -> Any:
        """Return the planner's action in ``env``; None when it thinks that the scan is finished."""
        inner = _inner(env)
        plan = self.plan(inner)
        return None if plan.viewpoint is None else inner.encode(plan)

    def plan(self, env: ViewPlanEnv[Any]) -> Plan:
        """Return the planner's plan; looks around first if it asks for that."""
        plan = ask_planner(self._planner, env.session)
        if plan.needs_panorama:
            env.look()
            plan = ask_planner(self._planner, env.session)
        return plan


@dataclass(frozen=True)
class Rollout:
    """What came of one episode.

    Attributes:
        total: Sum of the rewards.
        info: The last step's.
        rewards: By step.
    """

    total: float
    info: dict[str, Any]
    rewards: tuple[float, ...]


def rollout(
    env: gymnasium.Env[Any, Any], policy: PlannerPolicy, seed: int | None = None
) -> Rollout:
    """Return what comes of ``policy`` in one episode of ``env``.

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


def _inner(env: gymnasium.Env[Any, Any]) -> ViewPlanEnv[Any]:
    inner = env.unwrapped
    if not isinstance(inner, ViewPlanEnv):
        raise ConfigError(f"planners act in the environments of scan3d_twin.envs, not in {inner}")
    return inner
