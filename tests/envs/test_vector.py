"""Vector environments: one after the other, in processes and batched give the same bits."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.envs.vector import BatchedVectorEnv

ID = "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0"
OPTIONS = {"scene": ["three_boxes", "sine_box"], "fidelity": "kinematic"}
ACTIONS = [[2, 6, 10], [12, 6, 0], [9, 9, 9], [1, 2, 3], [7, 7, 7]]


def play(envs):
    try:
        seen = [envs.reset(seed=11)]
        seen += [envs.step(np.array(actions)) for actions in ACTIONS]
    finally:
        envs.close()
    return seen


def test_sync_async_and_batched_are_the_same():
    sync = play(gymnasium.make_vec(ID, 3, vectorization_mode="sync", **OPTIONS))
    apart = play(gymnasium.make_vec(ID, 3, vectorization_mode="async", **OPTIONS))
    batched = play(gymnasium.make_vec(ID, 3, workers=2, **OPTIONS))
    assert data_equivalence(sync, apart, exact=True)
    assert data_equivalence(sync, batched, exact=True)
    assert any(step[2].any() or step[3].any() for step in sync[1:])  # some began anew


def test_alone_in_this_process():
    envs = gymnasium.make_vec(ID, 2, workers=1, **OPTIONS)
    assert isinstance(envs, BatchedVectorEnv)
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    seen, info = envs.reset(seed=[4, 5])
    assert envs.observation_space.contains(seen)
    assert len(set(info["run_seed"])) == 2
    envs.close()


def test_what_cannot_be():
    with pytest.raises(ConfigError, match=">= 1"):
        BatchedVectorEnv("scan3d_twin/ViewPlanOverlap-v0", 0)
    with pytest.raises(UnknownNameError, match="kinematic"):
        gymnasium.make_vec(ID, 2, fidelity="none")
    envs = gymnasium.make_vec(ID, 2, workers=1, **OPTIONS)
    with pytest.raises(ValueError, match="2 environments"):
        envs.reset(seed=[1])
    envs.close()


def test_an_error_in_another_process_comes_here():
    envs = gymnasium.make_vec(ID, 2, workers=2, **OPTIONS)
    envs.reset(seed=0)
    with pytest.raises(gymnasium.error.InvalidAction):
        envs.step(np.array([5, 99]))
    envs.close()
