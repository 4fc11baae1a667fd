"""From the frames of a scan to beams: when each sample was taken, and at which angle.

A capsule states the angle of its first sample only; the turn to the next capsule is spread over its
samples. Where capsules in between were damaged, the turn is shared among them. No frame has a time:
samples are counted, and the earliest arrivals of late show when they were taken.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.core.types import VALID, Beams, FloatArray
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.rotating import to_elevation
from scan3d_twin.devices.rplidar.capsules import (
    ANGLE_UNITS,
    CAPSULE_LENGTH,
    TURN_UNITS,
    Capsule,
    decode_dense,
    decode_express,
    sample_angles,
)
from scan3d_twin.devices.rplidar.codec import ReplyType
from scan3d_twin.devices.rplidar.frames import MAX_NODE_RETREAT, CapsuleSplitter, NodeSplitter
from scan3d_twin.devices.rplidar.model import NO_RETURN, SAMPLES, RplidarModel, ScanMode
from scan3d_twin.devices.rplidar.nodes import DISTANCE_UNITS, NODE_LENGTH, angle_at, decode_node

CLOCK_WINDOW = 1.0
"""Time over which the earliest arrival is looked for [s]: a clock that is off by .1 % errs by 1 ms
in it; a poll every 5 ms meets some frame of it within a fraction of that."""
SETTLE = 0.1
"""Time of learning after which times are certain [s]: twenty polls, of which the luckiest comes
within a millisecond of the arrival of a frame; assumption."""
MAX_TURN_CHANGE = 0.04
"""Largest difference of the turn over a capsule from the mean, as a share of it; assumption.
Between two turns of an S3 it is .9 % (rplidar_ros#104)."""
MAX_START_CHANGE = 0.5
"""The same before the speed of this motor is known; an A1 may turn 1.4 times as fast as another.
When a series begins anew it is twice what it was."""
SMOOTHING = 0.1
"""Share of the latest turn in the running mean of the turn over a capsule."""
MAX_SPEED = 2.0
"""Fastest turn, as a share of the nominal one, over nodes of which some were damaged; an A1 turns
up to 1.4 times as fast as usual, and its optics shift nodes."""
MAX_IMPLAUSIBLE = 3
"""Implausible capsules in a row after which the series must have begun anew."""
_DECODERS = {ReplyType.EXPRESS: decode_express, ReplyType.DENSE: decode_dense}


class SampleClock:
    """Maps the count of samples to the host's clock.

    Frames arrive with a random delay, but never early, so the smallest delay of late is the line's.
    """

    def __init__(self, period: float) -> None:
        """Start without frames.

        Args:
            period: Time per sample [s].
        """
        self._period = period
        self._least: deque[tuple[float, float]] = deque()
        self._last = -math.inf
        self._since = math.inf
        self._latest = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether enough arrivals are known."""
        return self._latest - self._since >= SETTLE

    def learn(self, index: int, taken_by: float) -> None:
        """Take in that sample ``index`` was taken by a time [s]: its arrival less transmission."""
        offset = taken_by - index * self._period
        self._since, self._latest = min(self._since, taken_by), taken_by
        while self._least and self._least[-1][1] >= offset:
            self._least.pop()
        self._least.append((taken_by, offset))
        while self._least[0][0] < taken_by - CLOCK_WINDOW:
            self._least.popleft()

    def restart(self) -> None:
        """Forget all arrivals, after samples that were lost and not counted."""
        self._least.clear()
        self._since = math.inf

    def times(self, first: int, count: int) -> FloatArray:
        """Return when ``count`` samples from ``first`` on were taken [s]; never before earlier."""
        offset = self._least[0][1]
        times = offset + self._period * np.arange(first, first + count)
        times = np.maximum(times, self._last)
        self._last = float(times[-1])
        return np.asarray(times)


class CapsuleStream:
    """Makes beams of the bytes of an express or dense scan."""

    def __init__(self, model: RplidarModel, mode: ScanMode) -> None:
        self._model = model
        self._decode = _DECODERS[mode.reply]
        self._count = SAMPLES[mode.reply]
        self._clock = SampleClock(mode.sample_us * 1e-6)
        self._transmission = CAPSULE_LENGTH * BITS_PER_BYTE / model.baud
        self._splitter = CapsuleSplitter()
        self._implausible = self._refused = 0
        self._held: Capsule | None = None
        self._before: Capsule | None = None
        self._index = self._ahead = self._gap = 0
        self._step = self._count * mode.sample_us * 1e-6 * model.turns * TURN_UNITS
        self._slack = MAX_START_CHANGE

    @property
    def bad(self) -> int:
        """Capsules dropped."""
        return self._splitter.bad + self._refused

    def restart(self) -> None:
        """Forget what is unfinished, after bytes were discarded."""
        self._splitter.restart()
        self._clock.restart()
        self._held = self._before = None
        self._ahead = self._implausible = 0

    def feed(self, data: bytes, now: float) -> Beams:
        """Return the beams that are certain once ``data`` has arrived at ``now`` [s]."""
        parts = []
        for frame in self._splitter.feed(data, now):
            self._ahead += 1 + round(frame.skipped / CAPSULE_LENGTH)
            try:
                capsule = self._decode(frame.data)
            except ProtocolError:
                self._refused += 1
                continue
            if (beams := self._take(capsule, frame.arrival)) is not None:
                parts.append(beams)
        return Beams.join(parts)

    def _take(self, capsule: Capsule, arrival: float) -> Beams | None:
        """Return the beams of the capsule before ``capsule``; None if there are none."""
        held = self._held
        if held is None or self._implausible >= MAX_IMPLAUSIBLE:
            self._begin(capsule, arrival)
            return None

        # Check that it continues the turn, or shows that the one before did not
        step = self._step if capsule.is_first else self._measure_step(held, capsule, self._ahead)
        if self._is_held_astray(step, capsule):
            self._refused += 1
            self._index += self._ahead * self._count
            self._gap += self._ahead
            self._keep(capsule, arrival)
            return None
        if abs(step - self._step) > self._slack * self._step:
            self._refused += 1
            self._implausible += 1
            return None

        # Spread the turn over the samples of the capsule before
        first, self._index = self._index, self._index + self._ahead * self._count
        self._hold(capsule, arrival)
        beams = self._make_beams(held, first, step) if self._clock.is_settled else None
        self._step += (SMOOTHING if self._slack == MAX_TURN_CHANGE else 1.0) * (step - self._step)
        self._slack = MAX_TURN_CHANGE
        return beams

    def _measure_step(self, first: Capsule, capsule: Capsule, ahead: int) -> float:
        """Return the turn per capsule from ``first`` to ``capsule``, so many ahead [1/64 deg]."""
        turn = (capsule.start - first.start) % TURN_UNITS
        whole = max(0, round((ahead * self._step - turn) / TURN_UNITS))
        return (turn + whole * TURN_UNITS) / ahead

    def _is_held_astray(self, step: float, capsule: Capsule) -> bool:
        """Return whether ``capsule``, a turn of ``step`` per capsule on, fits better without it.

        Then the held one begins at a damaged angle, which its checksum has missed.
        """
        off = abs(step - self._step) * self._ahead
        if self._before is None or off <= MAX_TURN_CHANGE * self._step:
            return False
        ahead = self._gap + self._ahead
        return abs(self._measure_step(self._before, capsule, ahead) - self._step) * ahead < off / 2

    def _begin(self, capsule: Capsule, arrival: float) -> None:
        """Begin a series with ``capsule``."""
        # The speed stays nearly what it was, unless that does not help
        self._slack = min(MAX_START_CHANGE, 2 * self._slack)
        self._clock.restart()
        self._index += self._ahead * self._count
        self._held = None
        self._hold(capsule, arrival)

    def _hold(self, capsule: Capsule, arrival: float) -> None:
        """Keep ``capsule`` until the next one shows how far the lidar has turned over it."""
        self._before, self._gap = self._held, self._ahead
        self._keep(capsule, arrival)

    def _keep(self, capsule: Capsule, arrival: float) -> None:
        """Keep ``capsule`` in place of the held one."""
        self._held, self._ahead, self._implausible = capsule, 0, 0
        self._clock.learn(self._index + self._count - 1, arrival - self._transmission)

    def _make_beams(self, capsule: Capsule, first: int, step: float) -> Beams:
        angles = np.array(sample_angles(capsule, step))
        times = self._clock.times(first, self._count)
        mm = np.array(capsule.distances_mm, dtype=np.float64)
        return to_beams(times, angles, mm, self._model)


class NodeStream:
    """Makes beams of the bytes of a standard scan."""

    def __init__(self, model: RplidarModel, mode: ScanMode) -> None:
        self._model = model
        self._clock = SampleClock(mode.sample_us * 1e-6)
        self._transmission = NODE_LENGTH * BITS_PER_BYTE / model.baud
        self._splitter = NodeSplitter()
        self._index = 0
        self._angle = 0
        self._step = mode.sample_us * 1e-6 * model.turns * TURN_UNITS

    @property
    def bad(self) -> int:
        """Nodes dropped."""
        return self._splitter.bad

    def restart(self) -> None:
        """See ``CapsuleStream.restart``."""
        self._splitter.restart()
        self._clock.restart()

    def feed(self, data: bytes, now: float) -> Beams:
        """See ``CapsuleStream.feed``."""
        frames = self._splitter.feed(data, now)
        if not frames:
            return Beams.join([])

        # Count the samples and learn the clock, anew where more were lost than bytes skipped
        indices = []
        for frame in frames:
            steps = 1 + round(frame.skipped / NODE_LENGTH)
            if self._has_jumped(angle_at(frame.data, 0), steps):
                self._clock.restart()
            self._index += steps
            indices.append(self._index)
            self._clock.learn(self._index, frame.arrival - self._transmission)
        if not self._clock.is_settled:
            return Beams.join([])
        first = indices[0]
        times = self._clock.times(first, self._index - first + 1)

        # Decode
        nodes = [decode_node(frame.data) for frame in frames]
        angles = np.array([node.angle for node in nodes]) / ANGLE_UNITS
        mm = np.array([node.distance for node in nodes]) / DISTANCE_UNITS
        return to_beams(times[np.array(indices) - first], angles, mm, self._model)

    def _has_jumped(self, angle: int, steps: int) -> bool:
        """Return whether an ``angle`` [1/64 deg] is too far from the last for so many ``steps``."""
        before, self._angle = self._angle, angle
        turned = (angle - before + MAX_NODE_RETREAT) % TURN_UNITS - MAX_NODE_RETREAT
        return turned > MAX_NODE_RETREAT + MAX_SPEED * self._step * steps


ScanStream = CapsuleStream | NodeStream


def open_stream(model: RplidarModel, mode: ScanMode) -> ScanStream:
    """Return what decodes the frames of ``mode``."""
    if mode.reply is ReplyType.NODES:
        return NodeStream(model, mode)
    return CapsuleStream(model, mode)


def to_beams(times: FloatArray, angles: FloatArray, mm: FloatArray, model: RplidarModel) -> Beams:
    """Return beams from samples.

    Args:
        times: When each was taken (n,) [s].
        angles: Clockwise from the lidar's front (n,) [deg].
        mm: Distances (n,) [mm]; 0 and what is beyond the lidar's range is no return.
        model: The lidar.
    """
    valid = (mm >= model.min_range_mm) & (mm <= model.max_range_mm)
    return Beams(
        times,
        to_elevation(np.radians(angles)),
        np.where(valid, mm / 1000, np.nan),
        np.where(valid, VALID, NO_RETURN),
    )
