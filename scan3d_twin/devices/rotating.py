"""Lidars that turn all round: from a stream of beams to scan lines, and back for emulators.

Such a lidar measures by a clock of its own, whatever the speed of its motor. Its beams lie
elsewhere in each revolution, and a revolution has now more, now fewer of them. A driver puts the
beams of each packet into ``Revolutions``, which cuts them into lines; an emulator takes them out of
a ``Lidar`` by ``BeamReader``.

On its side, with the top to the robot's left, a lidar that turns clockwise seen from above has
elevations that rise with time: ``to_elevation`` is all of its geometry.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.hal import BeamStream, Lidar
from scan3d_twin.core.line_grid import arrange_line
from scan3d_twin.core.types import UNMEASURED, VALID, Beams, FloatArray, LidarSpec, ScanLine

MAX_BACKSTEP = math.radians(20.0)
"""Largest angle by which a beam may lie before its predecessor [rad]; the optics of triangulating
lidars shift beams by up to 14 deg by their distance."""
MIN_LINE_SHARE = 0.5
"""Share of the nominal readings of a revolution below which it is lost; assumption."""


def to_elevation(angle: FloatArray) -> FloatArray:
    """Return the elevations [rad] in [-pi, pi) of clockwise angles from the lidar's front [rad]."""
    return np.asarray((angle + math.pi) % math.tau - math.pi)


class Revolutions:
    """Cuts beams that arrive in order of time into lines, one for each whole revolution.

    Attributes:
        lost: Revolutions dropped because most of their beams were missing.
    """

    def __init__(self, spec: LidarSpec, readings: float) -> None:
        """Start without beams.

        Args:
            spec: The grid of the lines, see ``make_full_circle``.
            readings: Nominal number of readings in a revolution.
        """
        self.lost = 0
        self._spec = spec
        self._readings = readings
        self.clear()

    def clear(self) -> None:
        """Forget the beams of a revolution that has begun, after an interruption."""
        self._beams = Beams.join([])
        self._angles: FloatArray = np.empty(0)
        self._next = 0

    def add(self, beams: Beams) -> list[ScanLine]:
        """Take in ``beams``; return the lines that are complete now.

        The first revolution is complete only from the seam on: what comes before it is dropped.
        """
        if not len(beams):
            return []
        self._append(beams)

        # Find the revolutions that no later beam belongs to
        turns = np.floor(self._angles / math.tau).astype(np.int64)
        complete = math.floor((self._angles[-1] - MAX_BACKSTEP) / math.tau)
        lines = []
        for turn in range(self._next, complete):
            own = turns == turn
            if turn > 0 and np.count_nonzero(own) < MIN_LINE_SHARE * self._readings:
                self.lost += 1
            elif turn > 0:
                lines.append(self._make_line(turn, own))

        # Keep the last beam before the seam, to find the time of the seam
        if complete > self._next:
            self._next = complete
            first = int(np.argmax(turns >= complete))
            self._beams = self._beams.select(slice(max(0, first - 1), None))
            self._angles = self._angles[max(0, first - 1) :]
        return lines

    def _append(self, beams: Beams) -> None:
        """Append ``beams``, with angles from the seam of revolution 0 on that go on growing."""
        known = self._beams.select(slice(-1, None))
        joined = Beams.join([known, beams])
        steps, times = np.diff(joined.elevations), np.diff(joined.times)
        expected = math.tau * times / self._spec.line_period
        steps += math.tau * np.rint((expected - steps) / math.tau)
        start = self._angles[-1] if len(known) else joined.elevations[0] + math.pi
        angles = start + np.concatenate(([0.0], np.cumsum(steps)))
        self._angles = np.concatenate((self._angles, angles[len(known) :]))
        self._beams = Beams.join([self._beams, beams])

    def _make_line(self, turn: int, own: np.ndarray) -> ScanLine:
        """Return the beams that are ``own`` to a ``turn`` as a line, stamped at its seam."""
        first = int(np.argmax(own))
        angles, times = self._angles, self._beams.times
        before = max(0, first - 1)
        share = (math.tau * turn - angles[before]) / max(angles[first] - angles[before], 1e-9)
        stamp = float(times[before] + share * (times[first] - times[before]))
        beams = self._beams.select(own)
        return arrange_line(
            self._spec, stamp, angles[own] - math.tau * turn - math.pi, beams.times - stamp,
            beams.ranges, beams.codes,
        )  # fmt: skip


def share_seen(line: ScanLine) -> float:
    """Return which share of the beams of ``line`` see something; spare places are no beams."""
    beams = int(np.count_nonzero(line.codes != UNMEASURED))
    return int(np.count_nonzero(line.codes == VALID)) / max(1, beams)


class BeamReader:
    """Reads the beams of a ``Lidar`` in order of time, for an emulator."""

    def __init__(self, lidar: Lidar) -> None:
        self._lidar = lidar
        self._stream = lidar if isinstance(lidar, BeamStream) else None

    def read(self) -> Beams:
        """Return the beams measured and not yet returned.

        Those of a lidar that is no ``BeamStream`` come a line at a time, a revolution late.
        """
        if self._stream is not None:
            return self._stream.read_beams()
        parts = []
        while True:
            try:
                parts.append(list_beams(self._lidar.read_line(0.0), self._lidar.spec))
            except LinkTimeoutError:
                return Beams.join(parts)


def list_beams(line: ScanLine, spec: LidarSpec) -> Beams:
    """Return the beams of ``line`` in order of time."""
    times = line.stamp + (spec.beam_times if line.beam_times is None else line.beam_times)
    elevations = spec.elevations if line.elevations is None else line.elevations
    measured = np.flatnonzero(line.codes != UNMEASURED)
    order = measured[np.argsort(times[measured], kind="stable")]
    return Beams(times, to_elevation(elevations), line.ranges, line.codes).select(order)
