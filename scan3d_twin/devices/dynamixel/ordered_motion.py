"""The motion that an XL330 was told to make: sent step by step, guarded, and followed to its end.

While the servo moves, its own bus watchdog is armed; at rest it is off. What the servo was told is
compared with what it reports, and sent again where it differs.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.angle_history import AngleHistory
from scan3d_twin.devices.dynamixel.link import Answer, RefusedError, ServoLink, Steps
from scan3d_twin.devices.dynamixel.tick_clock import RestartedError

REST_TIME = 0.1
"""Time without a profile after which a motion has ended and the guard is taken off [s]."""
ACCELERATION = max(1, round(model.ACCELERATION / model.ACCELERATION_UNIT))
"""Content of the register of that name while the torque is on."""
STATE = reg.BUS_WATCHDOG.address, reg.PRESENT_POSITION.end
"""Part of the control table that is read each time: guard, profile, goal, timer and position."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Order:
    """A motion that was asked for.

    Attributes:
        position: Where to [counts], whole turns included.
        velocity: How fast [0.229 rev/min], at least 1: 0 would be as fast as it can.
    """

    position: int
    velocity: int


class OrderedMotion:
    """What a servo was told to do, and how much of it the servo knows and has done.

    Attributes:
        order: The latest order; None if there is none.
        is_pending: Whether a part of the order is still to be sent.
        is_on: Whether the torque was switched on for an order.
    """

    def __init__(self, angles: AngleHistory) -> None:
        """Order nothing yet from the servo whose ``angles`` are read."""
        self.order: Order | None = None
        self.is_pending = self.is_on = False
        self._is_armed = self._has_expired = False
        self._rest_since: float | None = None
        self._angles = angles

    @property
    def is_at_rest(self) -> bool:
        """Whether the order has been carried out."""
        return self._rest_since is not None

    def give(self, order: Order) -> None:
        """Replace the order; it is sent by ``carry_out``."""
        self.order, self.is_pending, self._rest_since = order, True, None

    def revoke(self) -> None:
        """Take the order back before anything of it was sent."""
        self.order, self.is_pending = None, False

    def resume(self, is_on: bool) -> None:
        """Go on with a servo that was away and says whether its torque ``is_on``."""
        # A torque that others have left on is not ours, nor is its profile
        self.is_on = is_on and self.order is not None
        self._is_armed = self._has_expired = False
        # What had been reached is held no more if the torque is off
        is_at_work = self._rest_since is None or not is_on
        self.is_pending = self.order is not None and is_at_work

    def note_torque_off(self) -> None:
        """Note that the servo has switched its torque off."""
        self.is_on = self.is_pending = False

    def carry_out(self, link: ServoLink, servo: int) -> Steps[None]:
        """Take the next step of the pending order: torque, guard, or profile and goal."""
        if not self.is_on:
            # Hold the present position first
            here = ACCELERATION, 1, self._angles.position - self._angles.whole_turns
            yield from link.write(servo, reg.PROFILE_ACCELERATION, *here)
            yield from link.write(servo, reg.TORQUE, 1)
            self.is_on, self._is_armed = True, False
            return
        if not self._is_armed:
            # What has expired is cleared by 0
            if self._has_expired:
                yield from link.write(servo, reg.BUS_WATCHDOG, 0)
            units = round(model.WATCHDOG / model.WATCHDOG_UNIT)
            yield from link.write(servo, reg.BUS_WATCHDOG, units)
            self._is_armed, self._has_expired = True, False
            return

        # The order may have been changed or taken back meanwhile
        if (order := self.order) is None:
            return
        profile = ACCELERATION, order.velocity, order.position - self._angles.whole_turns
        try:
            yield from link.write(servo, reg.PROFILE_ACCELERATION, *profile)
        except RefusedError:
            self._is_armed, self._has_expired = False, True
            raise
        if self.order is order:
            self.is_pending, self._rest_since = False, None

    def follow(self, link: ServoLink, servo: int, answer: Answer) -> Steps[None]:
        """See to it that the servo does what it was told; take the guard off when it has.

        Args:
            link: Its line.
            servo: Its id.
            answer: Its ``STATE``.

        Raises:
            RestartedError: It has lost its power, and with it what it was told.
        """
        if reg.PROFILE_ACCELERATION.find_in(answer.data, STATE[0]) != ACCELERATION:
            raise RestartedError
        order = self.order
        if order is None or (self._rest_since is not None and not self._is_armed):
            return

        # Goal and guard are as they were set, or the order is sent again
        goal = reg.GOAL_POSITION.find_in(answer.data, STATE[0]) + self._angles.whole_turns
        guard = reg.BUS_WATCHDOG.find_in(answer.data, STATE[0])
        self._has_expired = guard == model.WATCHDOG_EXPIRED
        if self._has_expired or goal != order.position:
            if self._has_expired:
                _log.warning("the turntable stopped, as this program was silent; it goes on")
            self.is_pending, self._is_armed = True, False
            return

        # At rest there is nothing to guard
        if reg.MOVING_STATUS.find_in(answer.data, STATE[0]) & model.PROFILE_ON:
            self._rest_since = None
        elif self._rest_since is None:
            self._rest_since = answer.sent
        elif answer.sent > self._rest_since + REST_TIME:
            yield from link.write(servo, reg.BUS_WATCHDOG, 0)
            self._is_armed = False

    def let_go(self, link: ServoLink, servo: int) -> Steps[None]:
        """Switch torque and guard off."""
        yield from link.write(servo, reg.TORQUE, 0)
        yield from link.write(servo, reg.BUS_WATCHDOG, 0)
        self.is_on = False
