"""The driver of the XL330: a ``Turntable`` over a serial line, by dynamixel-sdk.

What guards it: while it moves, the servo's own bus watchdog is armed, so that it stops by itself
0.3 s after this program has died or hangs. A program that goes on after that sends the goal again.
At rest the watchdog is off, since nothing is asked while the program computes. On closing the
torque is switched off, unless nothing was to turn: then it stays as it was.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NoReturn

from scan3d_twin.core.errors import (
    ConfigError,
    HazardError,
    LinkError,
    LinkTimeoutError,
    ProtocolError,
)
from scan3d_twin.core.hal import Clock, TurntableSpec
from scan3d_twin.core.types import TableAngle
from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.angle_history import AngleHistory
from scan3d_twin.devices.dynamixel.codec import ErrorNumber
from scan3d_twin.devices.dynamixel.connect import (
    Place,
    ServoInfo,
    explain_errors,
    find_servo,
    prepare_servo,
    read_health,
)
from scan3d_twin.devices.dynamixel.link import Answer, RefusedError, ServoLink, Steps
from scan3d_twin.devices.dynamixel.ordered_motion import STATE, Order, OrderedMotion
from scan3d_twin.devices.dynamixel.spec import limit_spec, to_angle
from scan3d_twin.devices.dynamixel.tick_clock import RestartedError, TickClock
from scan3d_twin.devices.links.transport import Transport

CONNECT_TIMEOUT = 12.0
"""Time-out from opening the port to the first angle [s]: the search takes up to 6 s where no servo
has the id 1, and a reboot 1 s."""
POLL = 0.005
"""Interval at which the port is polled while nobody else lets time pass [s]."""
BACKOFF = (0.1, 0.5)
"""First and longest wait between two attempts to reconnect [s]; it doubles each time."""
MAX_SILENCE = 1.0
"""Time in which no question has a good answer, after which the servo is looked for anew [s]: thirty
questions that time out."""
EXAMINED_AGAIN = 1.0
"""Time after which a servo that reports an error, but works, is asked again what it has [s]."""
MAX_REFUSALS = 3
"""Refused goals in a row after which the servo is set up anew."""
LENGTHS = 3
"""Number of lengths of the ``STATE`` that is read, which take turns: an answer that comes late is
not taken for that to the next question."""

_log = logging.getLogger(__name__)


@dataclass
class ServoStats:
    """Statistics of the link.

    Attributes:
        good: Angles received.
        bad: Answers that are missing, damaged or implausible.
        reconnects: Connections after the first.
        problem: The current problem; empty if there is none.
    """

    good: int = 0
    bad: int = 0
    reconnects: int = 0
    problem: str = ""


class Xl330Turntable:
    """A ``Turntable``: an XL330 behind a transport.

    There are no threads: ``service`` does all work, without waiting, including to reconnect after
    the servo was unplugged. Call it at least every 50 ms while it turns.

    Attributes:
        spec: See ``Turntable.spec``; with the limits that are set in this servo.
        info: The servo's description of itself.
        stats: Statistics of the link.
    """

    spec: TurntableSpec
    info: ServoInfo

    def __init__(self, open_transport: Callable[[], Transport], clock: Clock) -> None:
        """Connect and read the first angle; the servo does not move, its torque stays as it is.

        Args:
            open_transport: Opens the port; called again after the servo was unplugged.
            clock: The robot's clock.

        Raises:
            LinkError: There is no such servo, or it does not work; the message says why.
        """
        self.stats = ServoStats()
        self._open_transport, self._clock = open_transport, clock
        self._transport: Transport | None = None
        self._link: ServoLink | None = None
        self._place: Place | None = None
        self._angles = AngleHistory()
        self._motion = OrderedMotion(self._angles)
        self._velocity = self._length = 0
        self._hazard, self._is_told, self._examined = "", False, -math.inf
        self._work = self._run_work()
        try:
            self._connect_first()
        except BaseException:
            self.close()
            raise

    @property
    def bad(self) -> int:
        """Answers that are missing, damaged or implausible."""
        return self.stats.bad

    def service(self, now: float | None = None) -> None:
        """Take in what has arrived and ask for more, without waiting.

        Args:
            now: Ignored; the driver reads its clock itself.

        Raises:
            HazardError: The servo has switched its torque off.
        """
        next(self._work, None)
        if self._hazard and not self._is_told:
            self._is_told = True
            raise HazardError(self._hazard)

    def turn_to(self, angle: float, speed: float) -> tuple[float, float]:
        """See ``Turntable.turn_to``; the torque is switched on for the first motion.

        Raises:
            ConfigError: The angle is not finite, or the speed not positive.
        """
        if not (math.isfinite(angle) and math.isfinite(speed) and speed > 0):
            raise ConfigError(f"a turntable turns to an angle at a speed > 0, got {angle}, {speed}")
        if self._hazard:
            raise HazardError(self._hazard)
        low, high = self.info.positions
        position = max(low, min(high, round(angle / model.COUNT) + model.MIDDLE))
        velocity = max(1, min(self.info.max_velocity, round(speed / model.SPEED_UNIT)))
        self._give(Order(position, velocity))
        return to_angle(position), velocity * model.SPEED_UNIT

    def stop(self) -> None:
        """See ``Turntable.stop``; it takes the way to brake."""
        order = self._motion.order
        if order is None or self._motion.is_at_rest:
            return
        if not self._motion.is_on:
            self._motion.revoke()
            return
        speed = self._velocity * model.SPEED_UNIT
        way = math.copysign(speed**2 / (2 * model.ACCELERATION), speed)
        low, high = self.info.positions
        position = max(low, min(high, round(self._angles.position + way / model.COUNT)))
        self._give(replace(order, position=position))

    def angle(self) -> TableAngle:
        """See ``Turntable.angle``."""
        return self._angles.last()

    def angles_since(self, stamp: float) -> tuple[TableAngle, ...]:
        """See ``Turntable.angles_since``."""
        return self._angles.since(stamp)

    def close(self) -> None:
        """Stop, switch the torque off if it was told to turn, and close the port."""
        self._work.close()
        transport, self._transport = self._transport, None
        if transport is None:
            return
        with suppress(LinkError):
            if self._link is not None and self._motion.is_on:
                # Let the answer to the last question pass
                self._link.pump(POLL)
                for _ in self._motion.let_go(self._link, self.info.id):
                    self._link.pump(POLL)
        transport.close()

    def _give(self, order: Order) -> None:
        """Carry out an ``order`` as soon as the line is free."""
        self._motion.give(order)
        self.service()

    def _connect_first(self) -> None:
        deadline = self._clock.now() + CONNECT_TIMEOUT
        while not self._angles:
            if self._clock.now() >= deadline:
                raise LinkTimeoutError(
                    f"the turntable was not ready within {CONNECT_TIMEOUT:g} s: "
                    f"{self.stats.problem or 'no angle of it is good'}"
                )
            next(self._work)
            self._clock.sleep(POLL)

    def _run_work(self) -> Steps[NoReturn]:
        """Connect, turn, and reconnect whenever the link is lost."""
        wait, longest = BACKOFF
        while True:
            # Work until the link is lost
            good = self.stats.good
            try:
                yield from self._attend()
            except LinkError as error:
                if not self._angles:
                    raise
                self._drop_link(error)

            # Wait before the next attempt
            wait = BACKOFF[0] if self.stats.good > good else min(longest, 2 * wait)
            until = self._clock.now() + wait
            while self._clock.now() < until:
                yield

    def _drop_link(self, error: LinkError) -> None:
        if not self.stats.problem:
            _log.warning("turntable lost: %s; reconnecting", error)
        self.stats.problem = str(error)
        transport, self._transport, self._link = self._transport, None, None
        if transport is not None:
            transport.close()

    def _attend(self) -> Steps[NoReturn]:
        """Connect, carry out orders and read angles until the link is lost."""
        # Find the servo and set it up
        self._transport = self._open_transport()
        link, servo = yield from find_servo(self._transport, self._clock, self._place)
        self._link = link
        self._take_info((yield from prepare_servo(link, servo)))

        # Carry out an order, if there is a new one, step by step between two angles
        clock, silent_since, refusals = TickClock(), math.inf, 0
        while True:
            bad = link.bad
            if self._motion.is_pending and self._angles and not self._hazard:
                refusals = yield from self._try_order(link, servo, refusals)
            is_good = yield from self._read_state(link, servo, clock)
            self.stats.bad += link.bad - bad
            silent_since = math.inf if is_good else min(silent_since, self._clock.now())
            if self._clock.now() > silent_since + MAX_SILENCE:
                raise LinkTimeoutError(f"no good answer of the turntable for {MAX_SILENCE:g} s")

    def _try_order(self, link: ServoLink, servo: int, refusals: int) -> Steps[int]:
        """Send the pending order; return how often it has been refused in a row.

        Raises:
            RefusedError: It is refused for another reason than a guard that has expired.
        """
        try:
            yield from self._motion.carry_out(link, servo)
        except RefusedError as error:
            if error.number == ErrorNumber.RANGE and refusals < MAX_REFUSALS:
                return refusals + 1
            yield from self._find_hazard(link, servo)
            if not self._hazard:
                raise
        return 0

    def _take_info(self, info: ServoInfo) -> None:
        """Keep what a servo says about itself; a motion that was interrupted goes on."""
        self.stats.reconnects += self._place is not None
        self.info, self._place = info, Place(info.id, info.baud)
        self._motion.resume(info.is_on)
        self._angles.begin()
        self.spec = limit_spec(info.positions, info.max_velocity, info.baud)

    def _read_state(self, link: ServoLink, servo: int, clock: TickClock) -> Steps[bool]:
        """Read the state of the servo and act on it; return whether it answered well."""
        try:
            self._length = (self._length + 1) % LENGTHS
            answer = yield from link.read(servo, STATE[0], STATE[1] + self._length, attempts=1)
            self._keep_angle(answer, clock)
        except LinkTimeoutError:
            return False
        except RestartedError:
            raise
        except ProtocolError:
            self.stats.bad += 1
            return False
        if answer.alert and not self._hazard and answer.sent > self._examined + EXAMINED_AGAIN:
            self._examined = answer.sent
            yield from self._find_hazard(link, servo)
        if not self._hazard and self._motion.is_on and not self._motion.is_pending:
            yield from self._motion.follow(link, servo, answer)
        return True

    def _keep_angle(self, answer: Answer, clock: TickClock) -> None:
        """Store the angle of an ``answer``.

        Raises:
            ProtocolError: Its time or its position do not fit the others.
        """
        tick = reg.REALTIME_TICK.find_in(answer.data, STATE[0])
        position = reg.PRESENT_POSITION.find_in(answer.data, STATE[0])
        stamp = clock.stamp(tick, answer.sent, answer.received)
        self._angles.add(stamp, position, self.spec.max_speed)
        self._velocity = reg.PRESENT_VELOCITY.find_in(answer.data, STATE[0])
        self.stats.good += 1
        self.stats.problem = ""

    def _find_hazard(self, link: ServoLink, servo: int) -> Steps[None]:
        """Find out whether the servo has switched itself off, and why."""
        is_on, bits = yield from read_health(link, servo)
        if not bits or (is_on and self._motion.is_on):
            return
        reason, cure = explain_errors(bits)
        self._hazard = f"the turntable has switched its torque off: {reason}; {cure}, then go on"
        self._motion.note_torque_off()
