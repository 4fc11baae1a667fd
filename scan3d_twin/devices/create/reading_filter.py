"""Debounce readings while the link is noisy: an 8-bit checksum misses errors.

A corrupted frame that still has the form of a frame passes the checksum in 1 of 256 cases by
chance. With exactly two flipped bits it passes in 1 of 16: the same bit of two bytes, flipped up
in one and down in the other.
"""

from __future__ import annotations

import math

from scan3d_twin.devices.create.link import COUNTS, MOVED, Values
from scan3d_twin.devices.create.packets import Packet

NOISY_TIME = 1.0
"""Time for which the link counts as noisy after a transmission error [s]: 67 frames; assumption."""
NOT_DEBOUNCED: frozenset[Packet] = frozenset((*COUNTS, *MOVED))
"""Packets that change with every reading of a moving base; dead reckoning checks them itself."""


class ReadingFilter:
    """Debounces readings: on a noisy link a value must be read twice in a row to be accepted.

    On a clean link every reading is accepted at once, so that hazards stop the robot without delay.
    """

    def __init__(self) -> None:
        self._before: Values = {}
        self._accepted: Values = {}
        self._errors = 0
        self._last_error = -math.inf

    def is_noisy(self, now: float) -> bool:
        """Return whether transmission errors occurred within the last ``NOISY_TIME`` [s]."""
        return now - self._last_error < NOISY_TIME

    def count_errors(self, errors: int, now: float) -> bool:
        """Take in the total number of transmission errors; return whether it has grown."""
        has_grown, self._errors = errors > self._errors, errors
        if has_grown:
            self._last_error = now
        return has_grown

    def take(self, values: Values, now: float) -> Values:
        """Return the accepted readings after ``values`` have arrived at ``now`` [s]."""
        before, self._before = self._before, values
        if not (self.is_noisy(now) and self._accepted):
            self._accepted = values
        else:
            self._accepted = {
                packet: value
                if packet in NOT_DEBOUNCED or before.get(packet) == value
                else self._accepted.get(packet, value)
                for packet, value in values.items()
            }
        return self._accepted
