"""An emulated LD06, LD19 or STL27L: serves the beams of any ``Lidar`` as packets."""

from __future__ import annotations

import math
from collections import deque

from scan3d_twin.core.hal import Lidar
from scan3d_twin.core.types import VALID, Beams
from scan3d_twin.devices.ldrobot.codec import FULL_TURN, READINGS, TIME_PERIOD, Packet, encode
from scan3d_twin.devices.ldrobot.model import BOOT, EMULATED_INTENSITY, LdModel
from scan3d_twin.devices.rotating import BeamReader

MAX_STEP = 1.5
"""Time between two readings of a packet, in their period, above which readings are missing: the
packet begins again."""

MIN_FETCH = 0.009
"""Shortest time between two looks at what was measured [s]: each look costs the twin as much as a
hundred readings, and packets are put on the line that much later at most."""


class LdEmulator:
    """A ``Device``: a lidar that measures what ``lidar`` measures.

    It sends without being asked, from ``BOOT`` after power-up on, and takes no commands.

    Attributes:
        began: See ``Device``.
        baud: See ``Device``.
    """

    def __init__(self, lidar: Lidar, model: LdModel, *, usb: bool = False) -> None:
        self.baud = 0 if usb else model.baud
        self.began = 0.0
        self._reader = BeamReader(lidar)
        self._model = model
        self._out: deque[tuple[float, bytes]] = deque()
        self._beams = Beams.join([])
        self._powered_at, self._looked = 0.0, -math.inf

    def power_up(self, now: float) -> None:
        """Turn the power off, and on again at ``now`` [s]."""
        self._powered_at = now
        self._out.clear()
        self._beams = Beams.join([])

    def receive(self, data: bytes, now: float) -> None:
        """See ``Device.receive``: it hears nothing."""

    def transmit(self, now: float) -> bytes:
        """See ``Device.transmit``: one packet at a time."""
        self._measure(now)
        if not self._out:
            return b""
        self.began, data = self._out.popleft()
        return data

    def _measure(self, now: float) -> None:
        """Make packets of what was measured by ``now`` [s]."""
        if now - self._looked < MIN_FETCH:
            return
        self._looked = now
        beams = Beams.join([self._beams, self._reader.read()])
        start = 0
        while start + READINGS <= len(beams):
            part = beams.select(slice(start, start + READINGS))
            gaps = (part.times[1:] - part.times[:-1]) * self._model.sample_rate > MAX_STEP
            if gaps.any():
                start += int(gaps.argmax()) + 1
                continue
            start += READINGS
            if part.times[0] >= self._powered_at + BOOT:
                self._out.append((float(part.times[-1]), encode(self._pack(part))))
        self._beams = beams.select(slice(start, None))

    def _pack(self, beams: Beams) -> Packet:
        """Return twelve ``beams`` as a packet."""
        turns = beams.elevations / math.tau
        first, last = (round(FULL_TURN * float(turns[k])) % FULL_TURN for k in (0, -1))
        angle = 360.0 * (float(turns[-1] - turns[0]) % 1.0)
        seen = beams.codes == VALID
        distances = [
            round(1000 * distance) if valid else 0
            for distance, valid in zip(beams.ranges.tolist(), seen.tolist(), strict=True)
        ]
        return Packet(
            speed=round(angle / float(beams.times[-1] - beams.times[0])),
            start=first,
            end=last,
            time=math.floor(1000 * (float(beams.times[-1]) - self._powered_at)) % TIME_PERIOD,
            distances=tuple(distances),
            intensities=tuple(EMULATED_INTENSITY if valid else 0 for valid in seen.tolist()),
        )
