"""What a checksum of eight bits lets through is not believed at once on a line that garbles bytes.

Of the garbled frames that still look like one, 1 in 256 has the right sum by chance, and 1 in 16 of
those in which just two bits were turned over: once up and once down at the same place of a byte.
"""

from __future__ import annotations

import math

from scan3d_twin.devices.create.link import COUNTS, MOVED, Values
from scan3d_twin.devices.create.packets import Packet

DOUBT = 1.0
"""So long after bytes that made no sense the line is in doubt [s]: 67 frames; assumption."""
UNSIFTED: frozenset[Packet] = frozenset((*COUNTS, *MOVED))
"""Never the same twice while the base moves; the odometry checks them by what was commanded."""


class ReadingFilter:
    """Holds back what was read once only, while the line is in doubt.

    On a good line everything is believed at once, so that a stop for a hazard comes at once.
    """

    def __init__(self) -> None:
        self._before: Values = {}
        self._believed: Values = {}
        self._broken = 0
        self._broken_at = -math.inf

    def doubts(self, now: float) -> bool:
        """Tell whether the line garbled bytes lately."""
        return now - self._broken_at < DOUBT

    def line(self, broken: int, now: float) -> bool:
        """Note how many bytes made no sense so far; tell whether there are new ones."""
        worse, self._broken = broken > self._broken, broken
        if worse:
            self._broken_at = now
        return worse

    def take(self, values: Values, now: float) -> Values:
        """Return what is to be believed after the readings ``values``."""
        before, self._before = self._before, values
        if not (self.doubts(now) and self._believed):
            self._believed = values
        else:
            self._believed = {
                packet: value
                if packet in UNSIFTED or before.get(packet) == value
                else self._believed.get(packet, value)
                for packet, value in values.items()
            }
        return self._believed
