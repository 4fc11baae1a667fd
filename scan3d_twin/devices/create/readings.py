"""What a base reports, checked before it is believed: odometry, hazards and mode."""

from __future__ import annotations

from bisect import bisect_right

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.types import Hazards, Odometry
from scan3d_twin.devices.create.driving.dead_reckoning import (
    CommandedReckoning,
    Reckoning,
    make_reckoning,
)
from scan3d_twin.devices.create.driving.reading_filter import ReadingFilter
from scan3d_twin.devices.create.driving.speed_watch import SpeedWatch
from scan3d_twin.devices.create.hazards import decode_hazards
from scan3d_twin.devices.create.link import Contact, Values
from scan3d_twin.devices.create.packets import Mode, Packet

MIN_HISTORY = 20_000
"""Number of odometry samples always kept: 5 minutes."""
FORGET_BATCH = 2_000
"""Number of older samples deleted at a time."""


class BaseReadings:
    """Takes in the readings of a base in the order of their time.

    Attributes:
        mode: Mode that the base reports.
        hazards: Latest hazards.
        values: Latest readings that were believed.
        filter: Tells whether the line is noisy.
        rejected: Number of readings rejected by their values.
        reason: Why the latest readings were rejected; empty if they were not.
    """

    def __init__(self, spec: BaseSpec, contact: Contact) -> None:
        self.mode, self.hazards = Mode.PASSIVE, Hazards()
        self.values: Values = {}
        self.filter = ReadingFilter()
        self.rejected, self.reason = 0, ""
        self._spec, self._contact = spec, contact
        self._speeds = SpeedWatch(contact.model)
        self._reckoning: Reckoning | None = None
        self._history: list[Odometry] = []

    @property
    def latest(self) -> Odometry | None:
        """The latest odometry; None before the first reading."""
        return self._history[-1] if self._history else None

    @property
    def charging(self) -> bool:
        """Whether a charger is plugged in, or the base stands on its dock."""
        return bool(self.values.get(Packet.CHARGING_SOURCES))

    @property
    def requested_speeds(self) -> tuple[int, int]:
        """The commanded wheel speeds (right, left) that the base reports [mm/s]."""
        return self.values[Packet.REQUESTED_RIGHT], self.values[Packet.REQUESTED_LEFT]

    @property
    def has_unread_motion(self) -> bool:
        """Whether the base has moved since its distance was last read: a Create 1."""
        return isinstance(self._reckoning, CommandedReckoning) and self._reckoning.unread

    def is_safe(self) -> bool:
        """Return whether the base obeys drive commands."""
        return self.mode >= Mode.SAFE

    def since(self, stamp: float) -> tuple[Odometry, ...]:
        """Return the odometry after ``stamp`` [s], and the sample before it."""
        after = bisect_right(self._history, stamp, key=lambda sample: sample.stamp)
        return tuple(self._history[max(0, after - 1) :])

    def drive(self, stamp: float, right_mm: int, left_mm: int) -> None:
        """Record the wheel speeds [mm/s] that are commanded from ``stamp`` [s] on."""
        if self._reckoning is not None:
            linear, turn = (right_mm + left_mm) / 2000, (right_mm - left_mm) / 1000
            self._reckoning.drive(stamp, linear, turn / self._spec.wheel_base)

    def take(self, stamp: float, now: float, values: Values, sent: tuple[int, int]) -> bool:
        """Take in one set of readings; return whether its odometry was believed.

        Args:
            stamp: Time at which they were sampled [s].
            now: Time at which they have arrived [s].
            values: The readings.
            sent: Wheel speeds (right, left) last commanded [mm/s].
        """
        # Mask or reject impossible readings
        usable = self.filter.mask(values, self._contact, now)
        if usable is None:
            self._reject("a value is out of range")
            return False

        # Debounce and update the odometry
        if self._reckoning is None:
            self._reckoning = make_reckoning(self._spec, stamp, usable)
        doubtful = self.filter.is_noisy(now)
        believed = self.filter.take(usable, now)
        odometry = self._reckoning.take(stamp, usable, doubtful=doubtful)
        if odometry is not None:
            self._keep(odometry)
        else:
            self._reject("the wheel counts jump")
            if doubtful or not self._history:
                return False

        # Store mode and hazards
        if not doubtful:
            self._speeds.take(sent, stamp, usable)
        self.values = believed
        self.mode = Mode(believed[Packet.MODE] - self._contact.mode_offset)
        self.hazards = decode_hazards(believed)
        return odometry is not None

    def _keep(self, odometry: Odometry) -> None:
        self.reason = ""
        self._history.append(odometry)
        if len(self._history) > MIN_HISTORY + FORGET_BATCH:
            del self._history[:FORGET_BATCH]

    def _reject(self, reason: str) -> None:
        self.rejected, self.reason = self.rejected + 1, reason
