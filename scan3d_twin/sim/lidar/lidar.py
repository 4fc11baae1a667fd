"""The simulated lidar: free-running revolutions, each beam cast from its own pose."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError, LinkTimeoutError
from scan3d_twin.core.types import FloatArray, LidarSpec, Pose2, ScanLine, read_only
from scan3d_twin.sim.clock import SimClock
from scan3d_twin.sim.lidar.noise import Draws, warm_up_error
from scan3d_twin.sim.lidar.scanner import CHUNK, Evidence, Fan, Readings, Scanner
from scan3d_twin.sim.world import HISTORY_STEPS, TIMESTEP, World

MAX_UNREAD_LINES = 16
"""Most unread lines that are kept; assumption, the host's serial buffer of about 32 kB."""
MAX_SWEEP_DURATION = 0.9 * HISTORY_STEPS * TIMESTEP
"""Longest sweep that is computed at once [s], limited by the history of the lidar's poses."""

# Streams of the lidar's seed.
_NOISE, _JITTER, _LOSS, _SWAY, _OFFSET = 0, 1, 2, 3, 5
_BLOCK = 256


@dataclass(frozen=True, slots=True)
class Revolution:
    """A revolution that is not yet read, with all that its line needs.

    Attributes:
        number: Number of the revolution since the first that was sent.
        start: True time of step 0 [s].
        qpos: Positions of the scene's moving objects.
        end: True time of the next step 0 [s], where readings depend on it.
    """

    number: int
    start: float
    qpos: FloatArray
    end: float = math.nan


class SimLidar:
    """A ``Lidar`` on the twin.

    The noise of a revolution depends only on the seed and its number. So an unread line costs
    nothing and changes nothing, and a sweep read at once equals one read line by line.
    """

    def __init__(self, world: World, clock: SimClock, scanner: Scanner, seed: list[int]) -> None:
        # Keep the parts of the twin
        self._world = world
        self._clock = clock
        self._scanner = scanner
        self._seed = seed

        # Draw the mirror's phase and speed
        rng = np.random.default_rng(seed)
        self._start = float(rng.uniform(0.0, scanner.spec.line_period))
        mean, spread = scanner.config.period_error, scanner.config.revolution
        self._pace = 1 + mean + spread * float(rng.standard_normal())

        # Draw the error that stays
        offset = np.random.default_rng([*seed, _OFFSET]).standard_normal()
        self._offset = scanner.config.unit_offset * float(offset)

        # Start with no revolution
        self._jitter, self._drawn = np.empty(0), 0
        self._next = 0
        self._unread: deque[Revolution] = deque(maxlen=MAX_UNREAD_LINES)
        self._last: Revolution | None = None
        self.next_step = self._arrival(0)

    @property
    def spec(self) -> LidarSpec:
        """See ``Lidar.spec``."""
        return self._scanner.spec

    def _arrival(self, number: int) -> int:
        """Return the physics step at which line ``number`` arrives."""
        return math.ceil((self._time(number) + self._scanner.config.latency) / self._world.timestep)

    def service(self) -> None:
        """Queue the line that has arrived, unless it is lost."""
        number, start, self._next = self._next, self._time(self._next), self._next + 1
        self.next_step = self._arrival(self._next)
        if not self._is_lost(number):
            self._unread.append(self._make_turn(number, start))

    def _make_turn(self, number: int, start: float) -> Revolution:
        """Return revolution ``number``, which began at ``start`` [s], in the scene as it is."""
        return Revolution(number, start, self._world.scene_qpos())

    def _is_lost(self, number: int) -> bool:
        """Return whether line ``number`` is lost on its way."""
        loss = self._scanner.config.line_loss
        return loss > 0 and np.random.default_rng([*self._seed, _LOSS, number]).random() < loss

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``."""
        deadline = self._clock.step_after(timeout)
        while not self._unread:
            if self._world.steps >= deadline:
                raise LinkTimeoutError(f"no scan line within {timeout:g} s")
            self._clock.run_until(min(self.next_step, deadline))
        self._last = self._unread.popleft()
        return self._lines([self._last])[0]

    def read_sweep(self, count: int) -> tuple[ScanLine, ...]:
        """Return the next ``count`` lines, computed at once, bit by bit as by ``read_line``.

        Raises:
            ConfigError: The lines take longer than ``MAX_SWEEP_DURATION``.
            HazardError: As for ``Clock.sleep``.
        """
        if not (count >= 1 and count * self.spec.line_period <= MAX_SWEEP_DURATION):
            longest = int(MAX_SWEEP_DURATION / self.spec.line_period)
            raise ConfigError(f"a sweep read at once has 1 to {longest} lines, got {count}")
        turns: list[Revolution] = []
        while len(turns) < count:
            while not self._unread:
                self._clock.run_until(self.next_step)
            turns.append(self._unread.popleft())
        self._last = turns[-1]
        return tuple(self._lines(turns))

    def read_waiting(self, since: float = 0.0) -> tuple[ScanLine, ...]:
        """See ``BunchingLidar.read_waiting``: the same bits as by ``read_line``.

        At most the last ``MAX_UNREAD_LINES`` are kept.
        """
        turns = [turn for turn in self._unread if self._stamp(turn.start) >= since]
        self._unread.clear()
        self._last = turns[-1] if turns else self._last
        return tuple(self._lines(turns))

    def evidence(self) -> Evidence | None:
        """Return the ground truth of the last line read, for evaluation; None before the first."""
        if self._last is None:
            return None
        return self._measure([self._last], evidence=True).evidence[0]

    def _lines(self, turns: list[Revolution]) -> list[ScanLine]:
        """Return the lines of ``turns``, computed in chunks where the scene is static."""
        lines = []
        alone = bool(turns and len(turns[0].qpos)) or self._world.carriage is not None
        size = 1 if alone else CHUNK
        for first in range(0, len(turns), size):
            chunk = turns[first : first + size]
            readings = self._measure(chunk)
            for turn, ranges, codes in zip(chunk, readings.ranges, readings.codes, strict=True):
                stamp = self._stamp(turn.start)
                lines.append(ScanLine(stamp, read_only(ranges), read_only(codes, np.int64)))
        return lines

    def _measure(self, turns: list[Revolution], *, evidence: bool = False) -> Readings:
        # Interpolate the poses of all beams
        config, n = self._scanner.config, self.spec.n_beams
        starts = np.array([turn.start for turn in turns])
        times = starts[:, None] + self.spec.beam_times * self._pace
        positions, rotations = self._world.lidar_poses(times.ravel())
        rotations = rotations.reshape(len(turns), n, 3, 3)
        if config.sway > 0:
            rotations = np.stack([self._sway(turn.number) for turn in turns])[:, None] @ rotations

        # Draw the noise and measure
        rngs = [self._noise(turn.number) for turn in turns]
        return self._scanner.measure(
            turns[0].qpos,
            positions.reshape(len(turns), n, 3),
            rotations,
            Draws.of(rngs, n, config),
            np.array([self._drift(turn) for turn in turns]),
            fan=self._turned_fan(self.spec.elevations, times),
            evidence=evidence,
        )

    def _turned_fan(self, elevations: FloatArray, times: FloatArray) -> Fan | None:
        """Return the beams of a line on a turntable, measured at ``times``; None without one.

        The robot itself is where it is seen from the line's middle.
        """
        carriage = self._world.carriage
        if carriage is None:
            return None
        middle = float(carriage.angles(np.array([float(np.mean(times))]))[0])
        return self._scanner.make_fan(elevations, middle)

    def _drift(self, turn: Revolution) -> float:
        """Return the range error that all readings of a revolution share [m]."""
        return self._offset + warm_up_error(turn.start, self._scanner.config)

    def _noise(self, number: int) -> np.random.Generator:
        """Return the noise of a revolution."""
        return np.random.default_rng([*self._seed, _NOISE, number])

    def _sway(self, number: int) -> FloatArray:
        """Return the rotation (3, 3) by which the mast turns the lidar in a revolution."""
        rng = np.random.default_rng([*self._seed, _SWAY, number])
        return Pose2(0.0, 0.0, self._scanner.config.sway * rng.standard_normal()).matrix()[:3, :3]

    def _time(self, number: int) -> float:
        """Return the true time of step 0 of revolution ``number`` [s]; call in order of numbers."""
        if number >= self._drawn:
            rng = np.random.default_rng([*self._seed, _JITTER, self._drawn])
            self._jitter = self._scanner.config.jitter * rng.standard_normal(_BLOCK)
            self._drawn += _BLOCK
        turn = number * self.spec.line_period * self._pace
        return max(0.0, self._start + turn + float(self._jitter[number - self._drawn]))

    def _stamp(self, start: float) -> float:
        """Return ``start`` [s] rounded down to the resolution of the sensor's timer."""
        step = self._scanner.config.stamp_step
        return math.floor(start / step) * step if step > 0 else start
