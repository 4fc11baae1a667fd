"""The simulated lidar that turns all round and measures by a clock of its own.

Reading i is taken at the time t0 + i / f, wherever the rotor is then. Revolution k begins at s_k,
when the beam passes behind; within it the rotor turns evenly:

    elevation = 2 pi (t - s_k) / (s_{k+1} - s_k) - pi,    s_k <= t < s_{k+1}.

The s_k wander as those of the other lidars do (``period_error``, ``revolution``, ``jitter``), so
that revolutions have now more, now fewer readings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.line_grid import arrange_line, place_readings
from scan3d_twin.core.types import Beams, FloatArray, ScanLine, read_only
from scan3d_twin.sim.clock import SimClock
from scan3d_twin.sim.lidar.lidar import MAX_UNREAD_LINES, Revolution, SimLidar
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.scanner import Evidence, Readings, Scanner
from scan3d_twin.sim.world import World

_PHASE = 4
"""Stream of the lidar's seed, after those of ``SimLidar``."""


@dataclass(frozen=True, slots=True)
class _Samples:
    """Readings of one revolution, by the time at which they are taken.

    Attributes:
        turn: The revolution.
        times: True times (n,) [s].
        elevations: Beam angles (n,) [rad].
        first: Number of the first of them among all of the revolution.
        count: Number of readings of the whole revolution.
    """

    turn: Revolution
    times: FloatArray
    elevations: FloatArray
    first: int
    count: int


class RotatingLidar(SimLidar):
    """A ``BeamStream`` on the twin; lines and beams are read independently of each other."""

    def __init__(
        self, world: World, clock: SimClock, scanner: Scanner, seed: list[int], rate: float
    ) -> None:
        """Start turning.

        Args:
            world: The twin's world.
            clock: The robot's clock.
            scanner: Its ``spec`` is the grid of the lines.
            seed: Of the lidar's chance.
            rate: Readings per second [Hz].
        """
        if rate * scanner.spec.line_period > scanner.spec.n_beams:
            raise ConfigError(
                f"a grid of {scanner.spec.n_beams} beams holds no "
                f"{rate * scanner.spec.line_period:.0f} readings of a revolution"
            )
        self._starts: dict[int, float] = {}
        self._rate, self._streamed = rate, -math.inf
        super().__init__(world, clock, scanner, seed)
        self._first_sample = self._start_phase(seed)

    def _start_phase(self, seed: list[int]) -> float:
        """Return the time of sample 0 [s], which nothing ties to the rotor."""
        return float(np.random.default_rng([*seed, _PHASE]).uniform(0.0, 1.0 / self._rate))

    def read_beams(self) -> Beams:
        """See ``BeamStream.read_beams``."""
        now, since = self._clock.now(), self._streamed
        if now == since:
            return Beams.join([])
        self._streamed = now
        parts = []
        for number in self._recent_turns(now):
            begun, end = self._starts[number], self._starts[number + 1]
            if end > since and not self._is_lost(number):
                samples = self._sample(self._make_turn(number, begun), since, now)
                if len(samples.times):
                    parts.append(self._read(samples))
        return Beams.join(parts)

    def evidence(self) -> Evidence | None:
        """See ``SimLidar.evidence``; the directions and positions are those of the beams."""
        if self._last is None:
            return None
        samples = self._sample(self._last)
        found = self._measure_samples(samples, evidence=True).evidence[0]
        taken, own = place_readings(self.spec, samples.elevations)
        empty = Evidence(
            intensity=np.zeros(self.spec.n_beams),
            distances=np.full(self.spec.n_beams, np.inf),
            geoms=np.full(self.spec.n_beams, -1),
            normals=np.zeros((self.spec.n_beams, 3)),
            positions=np.full((self.spec.n_beams, 3), np.nan),
            directions=np.full((self.spec.n_beams, 3), np.nan),
        )
        for name in Evidence.__slots__:
            getattr(empty, name)[taken] = getattr(found, name)[own]
        return empty

    def _arrival(self, number: int) -> int:
        """Return the physics step at which line ``number`` arrives: after its last reading."""
        after = max(0.0, self._scanner.config.latency - self.spec.line_period)
        return math.ceil((self._time(number + 1) + after) / self._world.timestep)

    def _time(self, number: int) -> float:
        """Return the true time of the seam before revolution ``number`` [s].

        Only the last few revolutions are known.
        """
        if number not in self._starts:
            self._starts[number] = super()._time(number)
            self._starts.pop(number - 2 * MAX_UNREAD_LINES, None)
        return self._starts[number]

    def _recent_turns(self, now: float) -> list[int]:
        """Return the numbers of the revolutions known that have begun by ``now`` [s]."""
        while self._starts[latest := max(self._starts)] <= now:
            self._time(latest + 1)
        return [number for number in sorted(self._starts)[:-1] if self._starts[number] <= now]

    def _make_turn(self, number: int, start: float) -> Revolution:
        return replace(super()._make_turn(number, start), end=self._time(number + 1))

    def _lines(self, turns: list[Revolution]) -> list[ScanLine]:
        return [self._line(turn) for turn in turns]

    def _line(self, turn: Revolution) -> ScanLine:
        samples = self._sample(turn)
        beams = self._read(samples)
        return arrange_line(
            self.spec, self._stamp(turn.start), beams.elevations, beams.times - turn.start,
            beams.ranges, beams.codes,
        )  # fmt: skip

    def _sample(
        self, turn: Revolution, after: float = -math.inf, now: float = math.inf
    ) -> _Samples:
        """Return the readings of ``turn`` later than ``after`` and up to ``now`` [s]."""
        numbers = np.arange(
            math.ceil((turn.start - self._first_sample) * self._rate),
            math.ceil((turn.end - self._first_sample) * self._rate),
        )
        times = self._first_sample + numbers / self._rate
        wanted = (times > after) & (times <= now)
        elevations = math.tau * (times - turn.start) / (turn.end - turn.start) - math.pi
        first = int(np.argmax(wanted)) if len(wanted) else 0
        return _Samples(turn, times[wanted], elevations[wanted], first, len(times))

    def _read(self, samples: _Samples) -> Beams:
        readings = self._measure_samples(samples)
        return Beams(samples.times, samples.elevations, readings.ranges[0], readings.codes[0])

    def _measure_samples(self, samples: _Samples, *, evidence: bool = False) -> Readings:
        """Return the readings as one line."""
        # Interpolate the poses of the beams
        config, turn, n = self._scanner.config, samples.turn, len(samples.times)
        positions, rotations = self._world.lidar_poses(samples.times)
        if config.sway > 0:
            rotations = self._sway(turn.number) @ rotations

        elevations = read_only(samples.elevations)

        # Draw the noise of the whole revolution, whatever part of it is read
        whole = Draws.of([self._noise(turn.number)], samples.count, config)
        draws = whole.select(slice(samples.first, samples.first + n))
        return self._scanner.measure(
            turn.qpos,
            positions[None],
            rotations[None],
            draws,
            np.array([self._drift(turn)]),
            fan=self._turned_fan(elevations, samples.times) or self._scanner.make_fan(elevations),
            evidence=evidence,
        )
