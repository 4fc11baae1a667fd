"""Whether the wheels turn as fast as they are told: those of some bases know only a few speeds."""

from __future__ import annotations

import logging

from scan3d_twin.devices.create.codec import Model
from scan3d_twin.devices.create.link import Values
from scan3d_twin.devices.create.packets import Packet
from scan3d_twin.devices.create.roomba import step_speed

SETTLE = 0.3
"""Time after a drive command until the wheels turn steadily [s]; assumption: they need 0.1 s."""
WATCH = 0.5
"""Time over which their speed is measured [s]: a count is then 0.9 mm/s."""
NEAR_MM = 4.0
"""Difference up to which a wheel turns at a speed [mm/s]: well under half a step; assumption."""

log = logging.getLogger(__name__)


class SpeedWatch:
    """Compares the speeds of both wheels with those commanded; warns once of a stepped base."""

    def __init__(self, model: Model) -> None:
        self._mm_per_count = model.mm_per_count if model.has_counts else 0.0
        self._sent = (0, 0)
        self._since: tuple[float, tuple[int, int]] | None = None
        self._settled = 0.0
        self.is_stepped = False

    def take(self, sent: tuple[int, int], stamp: float, values: Values) -> None:
        """Take in the counts at ``stamp`` [s], with the speeds (right, left) commanded [mm/s].

        While the base reports other ones it is halted, or has not heard of these yet.
        """
        if not self._mm_per_count or self.is_stepped:
            return
        counts = values[Packet.RIGHT_COUNTS], values[Packet.LEFT_COUNTS]
        heard = values[Packet.REQUESTED_RIGHT], values[Packet.REQUESTED_LEFT]
        if sent != self._sent or heard != sent:
            self._sent, self._since, self._settled = sent, None, stamp + SETTLE
        elif any(sent) and stamp >= self._settled and self._since is None:
            self._since = stamp, counts
        elif self._since is not None and stamp >= self._since[0] + WATCH:
            self._compare(stamp, counts)

    def _compare(self, stamp: float, counts: tuple[int, int]) -> None:
        """Compare the speeds since ``_since``, and measure anew from here on."""
        assert self._since is not None
        began, before = self._since
        self._since = stamp, counts
        turned = (((b - a + 32768) & 0xFFFF) - 32768 for a, b in zip(before, counts, strict=True))
        speeds = [steps * self._mm_per_count / (stamp - began) for steps in turned]
        stepped = [step_speed(speed) for speed in self._sent]
        differs = max(abs(a - b) for a, b in zip(stepped, self._sent, strict=True)) > 2 * NEAR_MM
        fits = all(abs(a - b) < NEAR_MM for a, b in zip(speeds, stepped, strict=True))
        if differs and fits:
            self.is_stepped = True
            log.warning(
                "the base drives %.0f and %.0f mm/s where it was told %d and %d: it knows only a "
                "few speeds; with --sweep.yaw-rate 0.332 it turns as it is told",
                *speeds,
                *self._sent,
            )
