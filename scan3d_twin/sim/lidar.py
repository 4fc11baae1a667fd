"""The simulated URG-04LX: free-running revolutions, each beam cast from its own pose."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.types import FloatArray, LidarSpec, ScanLine, read_only
from scan3d_twin.sim.clock import SimClock
from scan3d_twin.sim.scanner import Scanner
from scan3d_twin.sim.world import TIMESTEP, World

UNREAD_LINES = 16
"""Unread lines that are kept; assumption, the host's serial buffer of some 32 kB."""
LATENCY = 0.1
"""From step 0 to the arrival of a line [s]; 101 ms in a capture of firmware 3.1.04 over USB."""


@dataclass(frozen=True, slots=True)
class _Revolution:
    """A revolution not yet read: enough to compute its line later."""

    stamp: float
    qpos: FloatArray
    rng: np.random.Generator


class SimLidar:
    """A ``Lidar`` on the twin.

    The noise of a revolution depends on the seed and its number alone, so a line that nobody reads
    costs nothing and changes nothing.
    """

    def __init__(self, world: World, clock: SimClock, scanner: Scanner, seed: list[int]) -> None:
        self._world = world
        self._clock = clock
        self._scanner = scanner
        self._seed = seed
        # The mirror turned before anyone listened.
        self._start = float(np.random.default_rng(seed).uniform(0.0, scanner.spec.line_period))
        self._next = 0
        self._unread: deque[_Revolution] = deque(maxlen=UNREAD_LINES)

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar.spec``."""
        return self._scanner.spec

    @property
    def next_step(self) -> int:
        """The physics step at which the next line arrives."""
        return math.ceil((self._stamp(self._next) + LATENCY) / TIMESTEP)

    def service(self) -> None:
        """Take in the line that has arrived, unless it is lost."""
        stamp = self._stamp(self._next)
        rng = np.random.default_rng([*self._seed, self._next])
        self._next += 1
        if rng.random() >= self._scanner.config.line_loss:
            self._unread.append(_Revolution(stamp, self._world.scene_qpos(), rng))

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        deadline = self._clock.step_after(timeout)
        while not self._unread:
            if self._world.steps >= deadline:
                raise LinkTimeoutError(f"no scan line within {timeout:g} s")
            self._clock.run_until(min(self.next_step, deadline))
        return self._line(self._unread.popleft())

    def _line(self, revolution: _Revolution) -> ScanLine:
        positions, rotations = self._world.lidar_poses(revolution.stamp + self.spec.beam_times)
        ranges, codes = self._scanner.measure(revolution.qpos, positions, rotations, revolution.rng)
        return ScanLine(revolution.stamp, read_only(ranges), read_only(codes, np.int64))

    def _stamp(self, index: int) -> float:
        return self._start + index * self.spec.line_period
