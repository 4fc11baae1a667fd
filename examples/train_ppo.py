"""Teach PPO to choose the overlap: train without physics, judge with it, on scenes never seen.

Needs Stable-Baselines3: ``pip install '.[rl]'``. Trains for ``--steps`` on random
scenes in ``kinematic``, then runs the trained agent, a random choice, fixed overlaps of 50 and 80 %
and the paper's planner on the same held-out scenes, first in ``kinematic``, then ``--scenes`` of
them in ``physics``; writes ``ppo.json`` and ``ppo.zip``. Ctrl-C ends
the training early.

Run: ``python examples/train_ppo.py [--steps 20000] [--seed 0] [--scenes 20] [--out runs/ppo]``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import FilterObservation, FlattenObservation

import scan3d_twin as s3d

ID = "scan3d_twin.envs:scan3d_twin/ViewPlanOverlap-v0"
OPTIONS = {"registration": {"engine": "grid", "scope": "sweep"}}
SEEN = ("pose", "stats", "action_mask")
POOL = [f"random:{seed}" for seed in range(1000, 1200)]
HELD_OUT = 500_000
Act = Callable[[gymnasium.Env[Any, Any], Any], Any]


def make(fidelity: str, scene: str | list[str] = "random") -> gymnasium.Env[Any, Any]:
    """Return the environment as the network sees it: a flat vector, no pictures."""
    env = gymnasium.make(ID, scene=scene, fidelity=fidelity, preset="paper", options=OPTIONS)
    return FlattenObservation(FilterObservation(env, SEEN))


def episode(env: gymnasium.Env[Any, Any], act: Act, seed: int) -> dict[str, Any]:
    """Return return, coverage, views and errors of one episode."""
    seen, info = env.reset(seed=seed)
    total, errors, etas, over = 0.0, [], [], False
    while not over:
        action = act(env, seen)
        if action is None:
            break
        seen, reward, terminated, truncated, info = env.step(action)
        total, over = total + float(reward), terminated or truncated
        errors.append(info["e_reg"])
        etas.append(info["eta"])
    return {
        "return": total, "coverage": info["coverage"], "views": info["views"],
        "overlap": float(np.mean(etas)) if etas else 0.0,
        "misplaced": float(np.mean(np.array(errors) > 0.010)) if errors else 0.0,
    }  # fmt: skip


def evaluate(fidelity: str, act: Act, count: int) -> list[dict[str, Any]]:
    """Return the episodes of ``act`` on held-out scenes: the same for every policy."""
    env = make(fidelity)
    return [episode(env, act, HELD_OUT + k) for k in range(count)]


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return means, and the 95 % interval of the mean return by 2000 bootstrap draws."""
    returns = np.array([run["return"] for run in runs])
    draws = np.random.default_rng(0).choice(returns, (2000, len(returns))).mean(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    means = {name: round(float(np.mean([run[name] for run in runs])), 3) for name in runs[0]}
    return {**means, "interval": [round(float(low), 3), round(float(high), 3)], "runs": len(runs)}


def baselines() -> dict[str, Act]:
    """Return the policies to compare with."""
    rng = np.random.default_rng(0)

    def planner(name: str) -> Act:
        policy = s3d.PlannerPolicy(name)
        return lambda env, seen: policy.act(env)

    names = ("fixed50", "fixed80", "siicp")
    return {"random": lambda env, seen: rng.integers(13), **{n: planner(n) for n in names}}


def train(steps: int, seed: int, workers: int) -> tuple[Any, list[tuple[int, float]]]:
    """Return the model and its learning curve: steps taken, mean return of the last episodes."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import SubprocVecEnv

    torch.set_num_threads(1)
    curve: list[tuple[int, float]] = []

    def watch(inside: dict[str, Any], outside: dict[str, Any]) -> bool:
        model = inside["self"]
        known = [done["r"] for done in model.ep_info_buffer]
        if known and model.num_timesteps >= 512 * (len(curve) + 1):
            curve.append((model.num_timesteps, round(float(np.mean(known)), 3)))
            print(*curve[-1], flush=True)
        return True

    venv = SubprocVecEnv([lambda: Monitor(make("kinematic", POOL))] * workers)
    model = PPO(
        "MlpPolicy", venv, seed=seed, n_steps=512 // workers, batch_size=128, n_epochs=8,
        learning_rate=1e-3, gamma=0.8, gae_lambda=0.8, ent_coef=0.003, target_kl=0.05,
        device="cpu", policy_kwargs={"net_arch": [32, 32]},
    )  # fmt: skip
    try:
        model.learn(steps, callback=watch)
    except KeyboardInterrupt:
        print("enough: judging what was learned so far")
    venv.close()
    return model, curve


def main() -> None:
    """Train, judge, write and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/ppo"))
    options = parser.parse_args()
    model, curve = train(options.steps, options.seed, options.workers)
    options.out.mkdir(parents=True, exist_ok=True)
    model.save(options.out / "ppo.zip")
    policies: dict[str, Act] = {
        "ppo": lambda env, seen: model.predict(seen, deterministic=True)[0],
        **baselines(),
    }
    result: dict[str, Any] = {"steps": model.num_timesteps, "curve": curve}
    for fidelity, count in (("kinematic", 5 * options.scenes), ("physics", options.scenes)):
        for name, act in policies.items():
            result[f"{fidelity}_{name}"] = summary(evaluate(fidelity, act, count))
            print(fidelity, name, result[f"{fidelity}_{name}"], flush=True)
            (options.out / "ppo.json").write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
