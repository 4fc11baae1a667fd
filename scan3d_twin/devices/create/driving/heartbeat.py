"""The sign of life that the driver gives to the guard, and how regular it was."""

from __future__ import annotations

from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links.guard import Guard


class Heartbeat:
    """Sends heartbeats to a guard and keeps the longest time between two in a drive."""

    def __init__(self, guard: Guard, clock: Clock, started: float) -> None:
        """Send nothing yet; the first interval begins at ``started`` [s]."""
        self._guard, self._clock = guard, clock
        self._latest, self._was_moving = started, False
        self._longest = 0.0

    def beat(self, moving: bool) -> None:
        """Send a heartbeat that says whether the base is driving."""
        self._guard.beat(moving)
        now = self._clock.now()
        if self._was_moving:
            self._longest = max(self._longest, now - self._latest)
        self._latest, self._was_moving = now, moving

    def take_longest(self) -> float:
        """Return the longest time between two heartbeats in a drive since the latest call [s]."""
        longest, self._longest = self._longest, 0.0
        return longest

    def interrupt(self) -> None:
        """Leave out the time until the next heartbeat, as the base cannot drive meanwhile."""
        self._was_moving = False

    def report_standing(self) -> None:
        """Tell the guard that the base stands."""
        self._guard.beat(False)
