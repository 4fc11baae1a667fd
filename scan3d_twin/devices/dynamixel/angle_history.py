"""The angles that a servo has reported, and which of them are believed."""

from __future__ import annotations

from bisect import bisect_right

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.core.types import TableAngle
from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel.spec import to_angle

HISTORY = 20_000
"""Number of angles kept: 100 s or more."""
MAX_JUMP = 0.1
"""Angle by which two neighbouring samples may differ at rest [rad]; assumption: a knock."""
MAX_JUMPS = 3
"""Samples in a row that are left out as a jump; the next is believed: somebody has turned it by
hand."""


class AngleHistory:
    """Angles in the order of their stamps, with the whole turns that a servo forgets.

    It does when it loses its power. While it was away it cannot have been turned by more than half
    a turn: its cable is fast.

    Attributes:
        position: The latest position, whole turns included [counts].
        whole_turns: What the servo has forgotten: whole turns [counts].
    """

    def __init__(self) -> None:
        self.position, self.whole_turns = model.MIDDLE, 0
        self._angles: list[TableAngle] = []
        self._jumps, self._is_first = 0, True

    def __len__(self) -> int:
        return len(self._angles)

    def last(self) -> TableAngle:
        """Return the latest angle."""
        return self._angles[-1]

    def since(self, stamp: float) -> tuple[TableAngle, ...]:
        """Return the angles from the last one before ``stamp`` [s] on, oldest first."""
        after = bisect_right(self._angles, stamp, key=lambda each: each.stamp)
        return tuple(self._angles[max(0, after - 1) :])

    def begin(self) -> None:
        """Believe the next angle whatever it is: the servo was away."""
        self._jumps, self._is_first = MAX_JUMPS, True

    def add(self, stamp: float, position: int, max_speed: float) -> None:
        """Add a position; one that is not later than the last is left out.

        Args:
            stamp: Its time [s].
            position: As the servo has it [counts].
            max_speed: Speed of the turntable [rad/s].

        Raises:
            ProtocolError: It cannot be reached in the time since the last one.
        """
        # Find the whole turns
        if self._is_first and self._angles:
            forgotten = (self.position - position) / model.COUNTS
            self.whole_turns = model.COUNTS * round(forgotten)
        self._is_first = False
        position += self.whole_turns
        angle = TableAngle(stamp, to_angle(position))

        # Refuse a jump
        if self._angles:
            passed = max(0.0, stamp - self._angles[-1].stamp)
            way = abs(angle.angle - self._angles[-1].angle)
            if way > MAX_JUMP + max_speed * passed and self._jumps < MAX_JUMPS:
                self._jumps += 1
                raise ProtocolError(f"the angle {angle.angle:.3f} is too far from the one before")
        self._jumps, self.position = 0, position

        # Keep it
        if not self._angles or stamp > self._angles[-1].stamp:
            self._angles.append(angle)
            if len(self._angles) > 2 * HISTORY:
                del self._angles[:-HISTORY]
