"""Vector environments: one after the other, in processes and batched give the same bits."""

import subprocess
import sys

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
    # An error here leaves no reply of the other process behind
    with pytest.raises(gymnasium.error.InvalidAction):
        envs.step(np.array([99, 5]))
    seen, info = envs.reset(seed=[3, 4])
    assert envs.observation_space.contains(seen)
    assert len(info["run_seed"]) == 2
    envs.close()


UNGUARDED = """
import gymnasium
envs = gymnasium.make_vec({id!r}, 2, workers=2, scene="three_boxes", fidelity="kinematic")
envs.reset(seed=1)
print(envs.step([6, 6])[1].shape)
envs.close()
"""


@pytest.mark.parametrize("from_stdin", [False, True])
def test_a_script_needs_no_main_guard(tmp_path, from_stdin):
    script = UNGUARDED.format(id=ID)
    (tmp_path / "script.py").write_text(script)
    run = subprocess.run(
        [sys.executable, "-" if from_stdin else tmp_path / "script.py"],
        input=script if from_stdin else None,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (run.returncode, run.stdout) == (0, "(2,)\n"), run.stderr


def test_what_only_the_main_program_knows_is_refused_by_name(monkeypatch):
    class Local(str):
        __slots__ = ()

    with pytest.raises(ConfigError, match=r"Local.*workers=1"):
        gymnasium.make_vec(ID, 2, workers=2, scene=[Local("three_boxes")], fidelity="kinematic")
    Local.__qualname__, Local.__module__ = "Local", "__main__"
    monkeypatch.setattr(sys.modules["__main__"], "Local", Local, raising=False)
    envs = gymnasium.make_vec(ID, 2, workers=2, scene=[Local("three_boxes")], fidelity="kinematic")
    with pytest.raises(ConfigError, match=r"main program.*Local.*workers=1"):
        envs.reset(seed=0)
    envs.close()
