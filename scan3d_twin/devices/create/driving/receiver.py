"""Reading the port of a base: stale bytes are discarded, and each reading gets its time."""

from __future__ import annotations

from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.driving.dead_reckoning import SampleTimes
from scan3d_twin.devices.create.driving.inquiry import Inquiry
from scan3d_twin.devices.create.readings import BaseReadings
from scan3d_twin.devices.links.transport import Transport

LISTENING = 0.03
"""Longest time between two reads of the port that counts as listening [s]."""
STALE, STALE_IF_NOISY = 0.5, 0.1
"""Time after which bytes that wait to be read are stale [s]; shorter on a noisy link, where lost
bytes make their age uncertain."""


class Receiver:
    """Takes what has arrived from a base over into its readings.

    Attributes:
        read_at: When the port was last read [s].
    """

    def __init__(
        self,
        transport: Transport,
        inquiry: Inquiry,
        readings: BaseReadings,
        period: float,
        started: float,
    ) -> None:
        """Begin to listen at ``started`` [s] to a base that samples with ``period`` [s].

        Its packets have been requested.
        """
        self.read_at = started
        self._transport, self._inquiry, self._readings = transport, inquiry, readings
        latency = inquiry.transfer_time(oi.frame_size(inquiry.packets))
        self._times = SampleTimes(period, latency)
        self._gap = False

    def receive(self, now: float, sent: tuple[int, int]) -> bool:
        """Take in what has arrived by ``now`` [s]; return whether there were readings.

        Args:
            now: Current time [s].
            sent: Wheel speeds (right, left) last commanded [mm/s].
        """
        # Discard stale bytes
        away = now - self.read_at
        if away > (STALE_IF_NOISY if self._readings.filter.is_noisy(now) else STALE):
            self._transport.discard_input()
            if away > STALE and sent == (0, 0):
                self._inquiry.ask_anew()

        # Count only the time spent listening as silence
        self._inquiry.note_deaf(max(0.0, away - LISTENING), now)
        self.read_at = now

        # Read, timestamp and take in
        readings = self._inquiry.read(now)
        self._gap |= self._readings.filter.count_errors(self._inquiry.source.errors, now)
        stamps = self._times.stamps(len(readings), now, gap=self._gap)
        for stamp, values in zip(stamps, readings, strict=True):
            self._gap = False
            if self._readings.take(stamp, now, values, sent):
                self._inquiry.note_reading(now)
        return bool(readings)

    def resume(self, now: float) -> None:
        """Listen again from ``now`` [s] on, after the base was unplugged."""
        self._inquiry.heard = self.read_at = now
        self._gap = True
