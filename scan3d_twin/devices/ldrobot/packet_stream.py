"""From packets to beams: what is plausible, when it was measured, and where it points.

A CRC-8 misses one damaged packet in 256, mostly one of which a byte was lost. Such a packet has its
angles, speed or time shifted: it is believed only if they follow from those of a packet before it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from scan3d_twin.core.types import VALID, Beams, FloatArray
from scan3d_twin.devices.ldrobot.codec import FULL_TURN, READINGS, SIZE, TIME_PERIOD, Packet
from scan3d_twin.devices.ldrobot.model import MAX_TURN_RATE_ERROR, TURN_RATE, LdModel
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.rotating import to_elevation

NO_RETURN = 0
"""Code of an invalid reading; the lidar gives no reason."""
MAX_GAP = 0.25
"""Longest time without a packet over which the angle is predicted [s]: at 1 % of speed error the
rotor is 9 deg off then."""
TIME_TOLERANCE = 1.5
"""Difference of a time from a whole number of packets [ms]: a resolution of 1 ms, and a clock off
by 0.2 % over ``MAX_GAP``."""
ANGLE_TOLERANCE = 200
"""Difference of an angle from its prediction [0.01 deg]: the manual's largest angle error."""
TRAVEL_TOLERANCE = 0.02
"""The same as a share of the angle turned since the last packet; the turn rate keeps 1 %."""
SPAN_TOLERANCE = 0.2
"""Difference of the angle over a packet from that by its speed, as a share; 9 deg are cut to whole
hundredths, the speed to whole deg/s."""
CLOCK_WINDOW = 10.0
"""Time over which the earliest arrival relates the lidar's timer to the clock [s]; a quartz is off
by less than 1 ms in it."""


class PacketStream:
    """Turns packets into beams on the host's clock.

    Attributes:
        rejected: Packets with a good checksum that do not follow from the others.
        speed: Turn rate by the last packet [Hz]; 0 before the first.
    """

    def __init__(self, model: LdModel) -> None:
        self.rejected = 0
        self.speed = 0.0
        self._model = model
        self._packet_time = 1000 * READINGS / model.sample_rate
        self._delay = SIZE * BITS_PER_BYTE / model.baud
        self._last: Packet | None = None
        self._doubtful: Packet | None = None
        self._count = 0
        self._stamp = 0
        self._time = self._unwrapped = 0.0
        self._offsets: deque[tuple[float, float]] = deque()

    def restart(self) -> None:
        """Forget the timer and the angle, after an interruption."""
        self._last = self._doubtful = None
        self._offsets.clear()

    def take(self, packets: list[Packet], now: float) -> Beams:
        """Return the beams of ``packets``, which had arrived by ``now`` [s]."""
        # Keep those that follow from each other
        kept: list[Packet] = []
        ends: list[float] = []
        for packet in packets:
            if self._is_plausible(packet):
                # The timer of those before an interruption is forgotten
                if self._count == 0:
                    kept.clear()
                    ends.clear()
                ends.append(self._find_time(packet))
                kept.append(packet)
        if not kept:
            return Beams.join([])
        self.speed = kept[-1].speed / 360.0

        # Place their readings in time and angle
        times = np.array(ends) + self._relate(ends[-1], now)
        before = np.arange(READINGS - 1, -1, -1) / self._model.sample_rate
        starts, spans = (np.array([getattr(p, name) for p in kept]) for name in ("start", "span"))
        angles = starts[:, None] + spans[:, None] * (np.arange(READINGS) / (READINGS - 1))
        distances = np.array([packet.distances for packet in kept]).ravel()
        return self._make_beams(
            (times[:, None] - before).ravel(), (angles * (math.tau / FULL_TURN)).ravel(), distances
        )

    def _make_beams(self, times: FloatArray, angles: FloatArray, distances: FloatArray) -> Beams:
        """Return readings of ``distances`` (n,) [mm] as beams."""
        model = self._model
        seen = (distances >= model.min_range_mm) & (distances <= model.max_range_mm)
        return Beams(
            times,
            to_elevation(angles),
            np.where(seen, distances / 1000, np.nan),
            np.where(seen, VALID, NO_RETURN),
        )

    def _is_plausible(self, packet: Packet) -> bool:
        """Return whether ``packet`` follows from the last one, or from one that was in doubt."""
        if not self._has_plausible_span(packet):
            self.rejected += 1
            return False
        if self._last is not None and self._follows(packet, self._last):
            self._count, _ = self._count_packets(packet, self._last)
            self._last, self._doubtful = packet, None
            return True
        if self._doubtful is not None and self._follows(packet, self._doubtful):
            self._last, self._doubtful, self._count = packet, None, 0
            return True
        self.rejected += self._last is not None
        self._doubtful = packet
        return False

    def _has_plausible_span(self, packet: Packet) -> bool:
        """Return whether speed and span of ``packet`` agree."""
        step = 100 * packet.speed / self._model.sample_rate
        expected = (READINGS - 1) * step
        return abs(packet.span - expected) <= 2 + SPAN_TOLERANCE * expected

    def _count_packets(self, packet: Packet, before: Packet) -> tuple[int, float]:
        """Return how many packets ``packet`` comes later, and by how much its angle is off.

        The angle gives the number within a turn, to a fraction of a packet, and the time gives the
        turns; the angle by which it is off is in 0.01 deg.
        """
        advance = 100 * before.speed * READINGS / self._model.sample_rate
        gap = advance / READINGS
        turned = (packet.start - before.end - gap) % FULL_TURN
        if turned > FULL_TURN - advance / 2:
            turned -= FULL_TURN
        elapsed = (packet.time - before.time) % TIME_PERIOD
        turns = round((elapsed / self._packet_time - 1 - turned / advance) * advance / FULL_TURN)
        exact = 1 + (turned + FULL_TURN * turns) / advance
        return round(exact), abs(exact - round(exact)) * advance

    def _follows(self, packet: Packet, before: Packet) -> bool:
        """Return whether time and angle of ``packet`` follow from those of ``before``."""
        count, off = self._count_packets(packet, before)
        elapsed = (packet.time - before.time) % TIME_PERIOD
        travel = 100 * before.speed * self._packet_time / 1000 * count
        return (
            1 <= count <= 1000 * MAX_GAP / self._packet_time
            and abs(elapsed - count * self._packet_time) <= TIME_TOLERANCE
            and off <= ANGLE_TOLERANCE + TRAVEL_TOLERANCE * travel
        )

    def _find_time(self, packet: Packet) -> float:
        """Return the time of the last reading of ``packet`` on the lidar's timer [s].

        Packets are evenly spaced; the time in a packet is that, cut to whole milliseconds.
        """
        if self._count == 0:
            self._offsets.clear()
            self._time = self._unwrapped = packet.time / 1000
        else:
            even = self._time + self._count * self._packet_time / 1000
            self._unwrapped += (packet.time - self._stamp) % TIME_PERIOD / 1000
            self._time = min(max(even, self._unwrapped), self._unwrapped + 0.001)
        self._stamp = packet.time
        return self._time

    def _relate(self, time: float, now: float) -> float:
        """Return the offset of the clock to the timer [s], by the earliest arrivals.

        Args:
            time: Timer of the latest reading [s].
            now: When its packet had arrived [s].
        """
        offset = now - self._delay - time
        while self._offsets and self._offsets[-1][1] >= offset:
            self._offsets.pop()
        self._offsets.append((time, offset))
        while self._offsets[0][0] < time - CLOCK_WINDOW:
            self._offsets.popleft()
        return self._offsets[0][1]


def is_under_own_control(speed: float) -> bool:
    """Return whether ``speed`` [Hz] is that of the lidar's own control."""
    return abs(speed / TURN_RATE - 1) <= MAX_TURN_RATE_ERROR
