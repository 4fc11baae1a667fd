"""The angles that a servo has reported, and which of them are believed."""

from __future__ import annotations

from bisect import bisect_right

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.core.types import TableAngle

HISTORY = 20_000
"""Number of angles kept: 100 s or more."""
MAX_JUMP = 0.1
"""Angle by which two neighbouring samples may differ at rest [rad]; assumption: a knock."""
MAX_JUMPS = 3
"""Samples in a row that are left out as a jump; the next is believed: somebody has turned it by
hand."""


class AngleHistory:
    """Angles in the order of their stamps."""

    def __init__(self) -> None:
        self._angles: list[TableAngle] = []
        self._jumps = 0

    def __len__(self) -> int:
        return len(self._angles)

    def last(self) -> TableAngle:
        """Return the latest angle."""
        return self._angles[-1]

    def since(self, stamp: float) -> tuple[TableAngle, ...]:
        """Return the angles from the last one before ``stamp`` [s] on, oldest first."""
        after = bisect_right(self._angles, stamp, key=lambda each: each.stamp)
        return tuple(self._angles[max(0, after - 1) :])

    def allow_jump(self) -> None:
        """Believe the next angle whatever it is."""
        self._jumps = MAX_JUMPS

    def add(self, angle: TableAngle, max_speed: float) -> None:
        """Add an ``angle``; one that is not later than the last is left out.

        Args:
            angle: The angle.
            max_speed: Speed of the turntable [rad/s].

        Raises:
            ProtocolError: It cannot be reached in the time since the last one.
        """
        if self._angles:
            passed = max(0.0, angle.stamp - self._angles[-1].stamp)
            way = abs(angle.angle - self._angles[-1].angle)
            if way > MAX_JUMP + max_speed * passed and self._jumps < MAX_JUMPS:
                self._jumps += 1
                raise ProtocolError(f"the angle {angle.angle:.3f} is too far from the one before")
        self._jumps = 0
        if not self._angles or angle.stamp > self._angles[-1].stamp:
            self._angles.append(angle)
            if len(self._angles) > 2 * HISTORY:
                del self._angles[:-HISTORY]
