"""Gymnasium environments for view planning: the digitisation loop with decisions left to an agent.

Importing this package registers ``scan3d_twin/ViewPlanOverlap-v0``, ``scan3d_twin/ViewPlanPose-v0``
and ``scan3d_twin/Candidates-v0``:

    gymnasium.make("scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0", scene="three_boxes")
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

from scan3d_twin.envs.options import FIDELITIES
from scan3d_twin.envs.policy import PlannerPolicy, Rollout, rollout

__all__ = ["ENV_IDS", "FIDELITIES", "PlannerPolicy", "Rollout", "rollout"]

MAX_EPISODE_STEPS = 40
"""Steps after which gymnasium truncates an episode, regardless of ``max_views``."""
_ENTRIES = {
    "scan3d_twin/ViewPlanOverlap-v0": "scan3d_twin.envs.overlap:OverlapEnv",
    "scan3d_twin/ViewPlanPose-v0": "scan3d_twin.envs.pose:PoseEnv",
    "scan3d_twin/Candidates-v0": "scan3d_twin.envs.candidates:CandidatesEnv",
}
ENV_IDS = tuple(_ENTRIES)
"""Ids of the registered environments."""

for _id, _entry in _ENTRIES.items():
    if _id not in registry:
        register(
            id=_id,
            entry_point=_entry,
            vector_entry_point=f"scan3d_twin.envs.vector:{_entry.split(':')[0].split('.')[-1]}",
            max_episode_steps=MAX_EPISODE_STEPS,
        )
