"""Vector environment: many environments batched over one process per core.

Each process steps its share one environment after the other, and loads each scene once for all of
them, with its ray caster and surface; the calling process takes the first share. The same seeds
give the same results as ``SyncVectorEnv``, to the last bit.

The processes are fresh interpreters: they never import the caller's main module, which may be a
script without a main guard, standard input or a notebook (``vector_worker.py``).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space, iterate

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.envs.vector_worker import Worker, call_method

Infos = dict[str, Any]


class BatchedVectorEnv(VectorEnv[Any, Any, Any]):
    """``num_envs`` environments of one kind; see the head of the module."""

    def __init__(
        self, env_id: str, num_envs: int = 1, workers: int | None = None, **options: Any
    ) -> None:
        """Make the environments.

        Args:
            env_id: Id of a registered environment.
            num_envs: Number of environments.
            workers: Number of processes, this one included; by default one per core.
            options: Options of each environment, as for ``gymnasium.make``.

        Raises:
            ConfigError: A number is not positive, or an option is wrong.
        """
        if num_envs < 1 or (workers is not None and workers < 1):
            raise ConfigError(f"num_envs and workers must be >= 1, got {num_envs} and {workers}")
        count = min(num_envs, workers or len(os.sched_getaffinity(0)))
        self.num_envs = num_envs

        # Share the environments among the processes.
        self._shares = np.array_split(np.arange(num_envs), count)
        build = partial(gymnasium.make, f"scan3d_twin.envs:{env_id}", **options)
        self._own = SyncVectorEnv([build] * len(self._shares[0]))
        self._others = [Worker(build, len(share)) for share in self._shares[1:]]

        # Describe the batch as gymnasium expects.
        self.metadata = {**self._own.metadata, "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.render_mode = self._own.render_mode
        self.single_action_space = self._own.single_action_space
        self.single_observation_space = self._own.single_observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, Infos]:
        """See ``VectorEnv``; environment k of an int has the seed ``seed`` + k."""
        seeds = _seed_list(seed, self.num_envs)
        parts = self._call_shares(
            "reset", [([seeds[k] for k in share], options) for share in self._shares]
        )
        return _concatenate([part[0] for part in parts]), self._merge_infos(
            [part[1] for part in parts]
        )

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Infos]:
        """See ``VectorEnv``: an environment that is done is reset at its next step."""
        single = list(iterate(self.action_space, actions))
        given = [(np.stack([single[k] for k in share]),) for share in self._shares]
        parts = self._call_shares("step", given)
        seen, rewards, ends, cuts = (
            _concatenate([part[column] for part in parts]) for column in range(4)
        )
        return seen, rewards, ends, cuts, self._merge_infos([part[4] for part in parts])

    def _call_shares(self, method: str, arguments: list[tuple[Any, ...]]) -> list[Any]:
        """Return the results of ``method`` of all shares, which run in parallel."""
        for worker, given in zip(self._others, arguments[1:], strict=True):
            worker.send(method, given)
        # Receive all replies before an error is raised: a reply left behind would be taken for the
        # next one.
        results: list[Any] = []
        errors: list[Exception] = []
        calls: list[Callable[[], Any]] = [partial(call_method, self._own, method, arguments[0])]
        calls += [worker.receive for worker in self._others]
        for call in calls:
            try:
                results.append(call())
            except Exception as error:  # noqa: BLE001 - raised below
                errors.append(error)
        if errors:
            raise errors[0]
        return results

    def _merge_infos(self, parts: list[Infos]) -> Infos:
        """Return the infos of the shares merged, in the layout of ``VectorEnv``."""
        sizes = [len(share) for share in self._shares]
        return _merge(parts, sizes)

    def close_extras(self, **kwargs: Any) -> None:
        """See ``VectorEnv``."""
        self._own.close()
        for worker in self._others:
            worker.close()


def _seed_list(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    if seed is None:
        return [None] * count
    if isinstance(seed, int):
        return [seed + k for k in range(count)]
    if len(seed) != count:
        raise ValueError(f"{count} environments need {count} seeds, got {len(seed)}")
    return list(seed)


def _concatenate(parts: list[Any]) -> Any:
    """Return the batches of the shares concatenated."""
    if isinstance(parts[0], dict):
        return {name: _concatenate([part[name] for part in parts]) for name in parts[0]}
    return np.concatenate(parts)


def _merge(parts: list[Infos], sizes: list[int]) -> Infos:
    """Return dictionaries of arrays concatenated; a share without a key contributes zeros."""
    merged: Infos = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        known = next(part[name] for part in parts if name in part)
        if isinstance(known, dict):
            merged[name] = _merge([part.get(name, {}) for part in parts], sizes)
            continue
        rows = [
            part[name] if name in part else _zeros_like(known, size)
            for part, size in zip(parts, sizes, strict=True)
        ]
        merged[name] = np.concatenate(rows)
    return merged


def _zeros_like(like: Any, size: int) -> Any:
    return np.full((size, *like.shape[1:]), None if like.dtype == object else 0, like.dtype)


def _of(env_id: str) -> Callable[..., BatchedVectorEnv]:
    return partial(BatchedVectorEnv, env_id)


overlap, pose, candidates = (
    _of(f"scan3d_twin/{name}-v0") for name in ("ViewPlanOverlap", "ViewPlanPose", "Candidates")
)
"""Entry points of ``gymnasium.make_vec``."""
