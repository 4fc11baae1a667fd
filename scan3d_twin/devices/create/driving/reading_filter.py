"""Debounce readings while the link is noisy: an 8-bit checksum misses errors.

A corrupted frame that still has the form of a frame passes the checksum in 1 of 256 cases by
chance. With exactly two flipped bits it passes in 1 of 16: the same bit of two bytes, flipped up
in one and down in the other.
"""

from __future__ import annotations

import logging
import math

from scan3d_twin.devices.create.link import COUNTS, MOVED, Contact, Values, find_implausible
from scan3d_twin.devices.create.packets import Mode, Packet

NOISY_TIME = 1.0
"""Time for which the link counts as noisy after a transmission error [s]: 67 frames; assumption."""
NOT_DEBOUNCED: frozenset[Packet] = frozenset((*COUNTS, *MOVED))
"""Packets that change with every reading of a moving base; dead reckoning checks them itself."""
KNOWN_BITS = {
    Packet.BUMPS_DROPS: 31,
    Packet.OVERCURRENTS: 31,
    Packet.CHARGING_SOURCES: 3,
    **dict.fromkeys(
        (
            Packet.CLIFF_LEFT,
            Packet.CLIFF_FRONT_LEFT,
            Packet.CLIFF_FRONT_RIGHT,
            Packet.CLIFF_RIGHT,
        ),
        1,
    ),
}
"""Bits that the Open Interface defines, in packets of flags."""

log = logging.getLogger(__name__)


class ReadingFilter:
    """Debounces readings: on a noisy link a value must be read twice in a row to be accepted.

    On a clean link every reading is accepted at once, so that hazards stop the robot without delay.

    Attributes:
        masked: Number of readings out of range that were left out.
    """

    def __init__(self) -> None:
        self.masked = 0
        self._odd: Values = {}
        self._named: set[int] = set()
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

    def mask(self, values: Values, contact: Contact, now: float) -> Values | None:
        """Return ``values`` without the readings that are out of range; None to reject them all.

        On a noisy link a reading out of range shows that the checksum has missed an error, unless
        it comes twice in a row: then it is what the base sends. So it is with the first readings,
        of a link of which nothing is known yet. Of flags only the defined bits are kept, other
        readings are as they were last accepted.
        """
        # Reject what may be an error of the line
        before, self._odd = self._odd, find_implausible(values, contact)
        is_doubtful = self.is_noisy(now) or not self._accepted
        if self._odd and is_doubtful and self._odd != before:
            return None

        # Mask what the base sends
        masked = dict(values)
        for packet, value in self._odd.items():
            known = KNOWN_BITS.get(Packet(packet))
            usual = contact.mode_offset + Mode.PASSIVE if packet == Packet.MODE else 0
            last = self._accepted.get(packet, usual)
            masked[packet] = last if known is None else value & known
            if packet not in self._named:
                self._named.add(packet)
                log.warning(
                    "the base sends %d in packet %d (%s), which is out of range: left out",
                    value,
                    packet,
                    Packet(packet).name.lower().replace("_", " "),
                )
        self.masked += len(self._odd)
        return masked

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
