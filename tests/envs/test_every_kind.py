"""What holds of every environment at every fidelity; with physics in the shortest of sweeps."""

import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence

from scan3d_twin.envs import ENV_IDS, FIDELITIES

KINDS = [(env_id, fidelity) for env_id in ENV_IDS for fidelity in FIDELITIES]
MATCHED = list(zip(ENV_IDS, FIDELITIES, strict=True))
"""Each kind once and each fidelity once."""
CHECKED = [kind for kind in KINDS if kind[1] == "kinematic" or kind in MATCHED]
"""What the checker of gymnasium, which resets some ten times, is asked about: no kind knows its
fidelity, and all pairs of both are reset and stepped below."""
QUICK = {
    "sweep": {"width": 0.6, "yaw_rate": 0.4, "look_rate": 1.0, "settle": 0.0},
    "motion": {"turn_rate": 3.0, "speed": 0.4},
    "max_views": 3,
}


def options(fidelity):
    return {"fidelity": fidelity, "options": QUICK if fidelity != "kinematic" else {}}


def play(env, steps=1):
    env.action_space.seed(8)
    seen = [env.reset(seed=8)]
    for _ in range(steps):
        seen.append(env.step(env.action_space.sample()))
    return seen


@pytest.mark.parametrize(("env_id", "fidelity"), CHECKED)
def test_gymnasium_has_nothing_to_say(env_id, fidelity):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = gymnasium.make(env_id, disable_env_checker=True, **options(fidelity))
        check_env(made.unwrapped, skip_render_check=fidelity != "kinematic")
        made.close()


@pytest.mark.parametrize(("env_id", "fidelity"), KINDS)
def test_stable_baselines_has_nothing_to_say(env_id, fidelity):
    checker = pytest.importorskip(
        "stable_baselines3.common.env_checker", reason="needs the extra [rl]"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = gymnasium.make(env_id, disable_env_checker=True, **options(fidelity))
        checker.check_env(made.unwrapped)
        made.close()


@pytest.mark.parametrize(("env_id", "fidelity"), KINDS)
def test_it_survives_pickling_and_its_spec(env_id, fidelity):
    env = gymnasium.make(env_id, **options(fidelity))
    pickled = pickle.loads(pickle.dumps(env.unwrapped))
    spec = gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())
    made = gymnasium.make(spec).unwrapped
    first = play(env.unwrapped)
    assert first[1][-1]["views"] == 2
    for other in (pickled, made):
        assert data_equivalence(first, play(other), exact=True)
        other.close()
    env.close()


@pytest.mark.parametrize(("env_id", "fidelity"), MATCHED)
def test_sync_async_and_batched_are_the_same(env_id, fidelity):
    runs = []
    for mode in ({"vectorization_mode": "sync"}, {"vectorization_mode": "async"}, {"workers": 2}):
        envs = gymnasium.make_vec(env_id, 2, **mode, **options(fidelity))
        envs.action_space.seed(5)
        seen = [envs.reset(seed=5), envs.step(envs.action_space.sample())]
        envs.close()
        runs.append(seen)
    sync, apart, batched = runs
    assert np.isfinite(sync[1][1]).all()
    assert data_equivalence(sync, apart, exact=True)
    assert data_equivalence(sync, batched, exact=True)
