"""Many environments at once: batched over as few processes as there are cores.

Each process steps its share one after the other and keeps each scene loaded once, with its ray
caster and surface, for all its environments; the caller's own process takes the first share. The
same seeds give the same bits as ``SyncVectorEnv``.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import gymnasium
import numpy as np
from gymnasium import error
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space, iterate

from scan3d_twin.core.errors import ConfigError

Infos = dict[str, Any]


class BatchedVectorEnv(VectorEnv[Any, Any, Any]):
    """``num_envs`` environments of one kind; see the head of the module."""

    def __init__(
        self, env_id: str, num_envs: int = 1, workers: int | None = None, **options: Any
    ) -> None:
        """Make the environments.

        Args:
            env_id: As registered.
            num_envs: How many.
            workers: Processes to share them, this one included; None is one per core.
            options: Of each, as for ``gymnasium.make``.

        Raises:
            ConfigError: A number is not positive, or an option is wrong.
        """
        if num_envs < 1 or (workers is not None and workers < 1):
            raise ConfigError(f"num_envs and workers must be >= 1, got {num_envs} and {workers}")
        count = min(num_envs, workers or len(os.sched_getaffinity(0)))
        self.num_envs = num_envs
        self._shares = np.array_split(np.arange(num_envs), count)
        build = partial(gymnasium.make, f"scan3d_twin.envs:{env_id}", **options)
        self._own = SyncVectorEnv([build] * len(self._shares[0]))
        self._others = [_Worker(build, len(share)) for share in self._shares[1:]]
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
        seeds = _seeds(seed, self.num_envs)
        parts = self._all("reset", [([seeds[k] for k in share], options) for share in self._shares])
        return _joined([part[0] for part in parts]), self._merged([part[1] for part in parts])

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, Infos]:
        """See ``VectorEnv``: what has ended begins anew at the next step."""
        single = list(iterate(self.action_space, actions))
        given = [(np.stack([single[k] for k in share]),) for share in self._shares]
        parts = self._all("step", given)
        seen, rewards, ends, cuts = (
            _joined([part[column] for part in parts]) for column in range(4)
        )
        return seen, rewards, ends, cuts, self._merged([part[4] for part in parts])

    def _all(self, method: str, arguments: list[tuple[Any, ...]]) -> list[Any]:
        """Return what ``method`` gives in all shares, the others at work meanwhile."""
        for worker, given in zip(self._others, arguments[1:], strict=True):
            worker.send(method, given)
        own = _call(self._own, method, arguments[0])
        return [own, *(worker.receive() for worker in self._others)]

    def _merged(self, parts: list[Infos]) -> Infos:
        """Return the infos of the shares as one, as ``VectorEnv`` lays them out."""
        sizes = [len(share) for share in self._shares]
        return _merge(parts, sizes)

    def close_extras(self, **kwargs: Any) -> None:
        """See ``VectorEnv``."""
        self._own.close()
        for worker in self._others:
            worker.close()


class _Worker:
    """A share of the environments in a process of its own."""

    def __init__(self, build: Callable[[], Any], count: int) -> None:
        context = multiprocessing.get_context("forkserver")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, build, count), daemon=True)
        self._process.start()
        theirs.close()

    def send(self, method: str, arguments: tuple[Any, ...]) -> None:
        self._pipe.send((method, arguments))

    def receive(self) -> Any:
        try:
            result, failure = self._pipe.recv()
        except EOFError:
            raise error.Error("a process of the batched environments has died") from None
        if failure is not None:
            raise failure
        return result

    def close(self) -> None:
        if self._process.is_alive():
            self._pipe.close()
            self._process.join()


def _serve(pipe: Connection, build: Callable[[], Any], count: int) -> None:
    """Step ``count`` environments for whoever holds the other end, until it is closed."""
    envs = SyncVectorEnv([build] * count)
    while True:
        try:
            method, arguments = pipe.recv()
        except EOFError:
            break
        try:
            pipe.send((_call(envs, method, arguments), None))
        except Exception as failure:  # noqa: BLE001 - it is raised where the call came from
            pipe.send((None, failure))
    envs.close()


def _call(envs: SyncVectorEnv, method: str, arguments: tuple[Any, ...]) -> Any:
    if method == "step":
        return envs.step(*arguments)
    seeds, options = arguments
    return envs.reset(seed=seeds, options=options)


def _seeds(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    if seed is None:
        return [None] * count
    if isinstance(seed, int):
        return [seed + k for k in range(count)]
    if len(seed) != count:
        raise ValueError(f"{count} environments need as many seeds, got {len(seed)}")
    return list(seed)


def _joined(parts: list[Any]) -> Any:
    """Return the batches of the shares as one."""
    if isinstance(parts[0], dict):
        return {name: _joined([part[name] for part in parts]) for name in parts[0]}
    return np.concatenate(parts)


def _merge(parts: list[Infos], sizes: list[int]) -> Infos:
    """Return dictionaries of arrays as one; where a share lacks a key, it has zeros."""
    merged: Infos = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        known = next(part[name] for part in parts if name in part)
        if isinstance(known, dict):
            merged[name] = _merge([part.get(name, {}) for part in parts], sizes)
            continue
        rows = [
            part[name] if name in part else _nothing(known, size)
            for part, size in zip(parts, sizes, strict=True)
        ]
        merged[name] = np.concatenate(rows)
    return merged


def _nothing(like: Any, size: int) -> Any:
    return np.full((size, *like.shape[1:]), None if like.dtype == object else 0, like.dtype)


def _of(env_id: str) -> Callable[..., BatchedVectorEnv]:
    return partial(BatchedVectorEnv, env_id)


overlap, pose, candidates = (
    _of(f"scan3d_twin/{name}-v0") for name in ("ViewPlanOverlap", "ViewPlanPose", "Candidates")
)
"""Entry points of ``gymnasium.make_vec``."""
