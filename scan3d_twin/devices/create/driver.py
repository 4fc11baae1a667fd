"""The driver of the iRobot Create 1, Create 2 and Roomba 500 and 600: a ``DriveBase`` over bytes.

There are no threads: whoever waits calls ``service``. The base has no watchdog and keeps executing
its last drive command, so the driver stops it on every hazard and on every exit, and sends
heartbeats to a guard process.
"""

from __future__ import annotations

import logging
import math
from contextlib import suppress

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.navigation.wheel_kinematics import split_velocity
from scan3d_twin.core.types import Hazards, Odometry
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Model, Op
from scan3d_twin.devices.create.driving.heartbeat import Heartbeat
from scan3d_twin.devices.create.driving.inquiry import ASK_AGAIN, LOST_AFTER, Inquiry
from scan3d_twin.devices.create.driving.order_watch import OrderWatch
from scan3d_twin.devices.create.driving.receiver import Receiver
from scan3d_twin.devices.create.hazards import (
    LOW_BATTERY,
    blocking_hazards,
    check_ready,
    find_unsafe_causes,
)
from scan3d_twin.devices.create.identification import find_base
from scan3d_twin.devices.create.link import (
    MODE_SETTLE,
    Contact,
    base_spec,
    packets_at_rest,
    watched_packets,
)
from scan3d_twin.devices.create.packets import Mode
from scan3d_twin.devices.create.readings import BaseReadings
from scan3d_twin.devices.links.guard import Guard, NoGuard
from scan3d_twin.devices.links.transport import Transport, is_away

log = logging.getLogger(__name__)

SILENCE = 0.3
"""Silence of a driving base after which a stop is sent [s]; 20 periods."""
MAX_OUTAGE = 30.0
"""Time to wait for an unplugged base [s]: enough to fasten a plug; assumption."""
UNSERVICED = 0.25
"""Time without ``service`` after which the guard may have stopped a driving base [s]."""
GUARD_TIMEOUT = 0.3
"""Time without a heartbeat after which the guard stops the wheels [s]."""
MAX_HANG = 10.0
"""Time without ``service`` after which driving is not resumed [s]: by then nobody expects the robot
to move; assumption."""
STOPPING_TIME = 0.2
"""Time from a stop command until the wheels stand [s]; they decelerate with 1.8 m/s2."""
STOP = oi.drive_direct(0, 0)
FAREWELL = STOP + oi.command(Op.PAUSE_RESUME, 0) + oi.command(Op.START)
"""Stops the wheels, pauses the stream and enters Passive, where the base may charge and sleep."""


def open_create(
    transport: Transport, clock: Clock, guard: Guard | None = None, stated: Model | None = None
) -> CreateBase:
    """Connect to the base on the line; it stands still, in mode Passive.

    Args:
        transport: The line to the base.
        clock: The robot's clock; its ``sleep`` may service the base.
        guard: Stops the wheels if this process cannot; None if no guard is needed.
        stated: The model that the user states; None to find it out.

    Raises:
        LinkTimeoutError: No base answers.
        LinkError: It is not clear which model answers, or another one than is stated.
    """
    contact = find_base(transport, clock, stated)
    return CreateBase(transport, clock, contact, NoGuard() if guard is None else guard)


class CreateBase:
    """A ``DriveBase`` on a serial line; made by ``open_create``.

    Attributes:
        spec: See ``DriveBase.spec``.
    """

    def __init__(self, transport: Transport, clock: Clock, contact: Contact, guard: Guard) -> None:
        # Device and port
        self._transport, self._clock = transport, clock
        started = clock.now()
        self._heartbeat = Heartbeat(guard, clock, started)

        # Request the first packets
        self._inquiry = Inquiry(transport, clock, contact)
        self._inquiry.ask(packets_at_rest(contact))
        self.spec = base_spec(contact.model, streams=self._inquiry.streams)
        self._patience = ASK_AGAIN if self._inquiry.streams else 3 * ASK_AGAIN
        self._readings = BaseReadings(self.spec, contact)
        period = self.spec.sample_period
        self._receiver = Receiver(transport, self._inquiry, self._readings, period, started)

        # State of the commands
        self._sent = (0, 0)
        self._sent_at = self._halted_at = self._safe_at = -math.inf
        self._orders = OrderWatch(clock.now())
        self._resumes = self._waiting = False

        # Wait for the first reading
        while self._readings.latest is None:
            clock.sleep(oi.PERIOD / 3)
            self._receiver.receive(clock.now(), self._sent)
            self._check_silence(clock.now())

    @property
    def contact(self) -> Contact:
        """Model and baud rate of the base."""
        return self._inquiry.contact

    @property
    def mode(self) -> Mode:
        """Mode that the base reports."""
        return self._readings.mode

    @property
    def bad(self) -> int:
        """Readings dropped since the packets were last requested, or by their values at all."""
        return self._inquiry.source.bad + self._readings.rejected

    @property
    def charging(self) -> bool:
        """Whether a charger is plugged in, or the base stands on its dock."""
        return self._readings.charging

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``.

        Raises:
            HazardError: The base cannot drive: it is on its charger, its battery is low, or it does
                not enter Safe mode.
        """
        left, right = (round(1000 * v) for v in split_velocity(self.spec, linear, angular))
        if right or left:
            self._prepare()
        self._drive(right, left)
        return (right + left) / 2000, (right - left) / 1000 / self.spec.wheel_base

    def odometry(self) -> Odometry:
        """See ``DriveBase.odometry``."""
        assert self._readings.latest is not None, "the constructor waits for it"
        return self._readings.latest

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        return self._readings.since(stamp)

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._readings.hazards

    def service(self, now: float) -> None:
        """Take in what has arrived, and stop the wheels if something is wrong.

        Raises:
            HazardError: There is a new hazard, the robot drives towards one it already has, or the
                base falls silent while driving. The wheels have been stopped.
            LinkError: The base falls silent while standing, or the port is gone.
        """
        # Reconnect if unplugged
        if is_away(self._transport):
            self._wait_for_the_plug()
            return

        # Take in the readings
        before, away = self.hazards(), now - self._receiver.read_at
        if self._moving and away > UNSERVICED:
            self._readings.drive(self._receiver.read_at + min(away, GUARD_TIMEOUT), 0, 0)
        fresh = self._receiver.receive(now, self._sent)
        self._heartbeat.beat(self._moving)
        hung = max(away, self._heartbeat.take_longest())

        # Stop after a hang
        if self._moving and away > MAX_HANG:
            self._drive(0, 0)
            raise HazardError(
                f"stopped: this program hung for {away:.1f} s while the robot drove (the guard "
                "stopped it meanwhile); end other programs"
            )
        if self._moving and hung > UNSERVICED:
            self._halt(now, f"this computer was busy for {hung:.2f} s")

        # Check hazards, silence and rest
        if fresh:
            self._check_hazards(before, now)
        self._check_silence(now)
        self._read_at_rest(now)
        self._keep_awake(now)

    def close(self) -> None:
        """Stop the wheels and leave the base in mode Passive; the port stays open."""
        with suppress(LinkError):
            self._inquiry.return_to_baud()
            self._transport.write(FAREWELL)
        self._sent = (0, 0)
        self._heartbeat.report_standing()

    @property
    def _moving(self) -> bool:
        return self._sent != (0, 0)

    # Driving.

    def _prepare(self) -> None:
        """Prepare to drive: leave Passive, and on a Create 1 stop reading packets 19 and 20.

        Raises:
            HazardError: The base cannot drive, or does not enter Safe mode.
        """
        # Check charger, battery and packets
        self._catch_up()
        check_ready(self.hazards(), charging=self.charging)
        if self._inquiry.packets != watched_packets(self.contact):
            self._inquiry.ask(watched_packets(self.contact))
        if self._readings.is_safe():
            return

        # Request Safe mode until it is reported; where the cause is known, three times are enough
        asked, give_up = 0, self._clock.now() + LOST_AFTER
        while self._clock.now() < give_up and not (asked >= 3 and self.hazards().active()):
            asked += 1
            self._transport.write(oi.command(Op.SAFE))
            deadline = self._clock.now() + MODE_SETTLE + ASK_AGAIN
            self._clock.sleep(MODE_SETTLE)
            self.service(self._clock.now())
            while not self._readings.is_safe() and self._clock.now() < deadline:
                self._clock.sleep(oi.PERIOD / 3)
                self.service(self._clock.now())
            if self._readings.is_safe():
                return

        causes = ", ".join(self.hazards().active()) or "unknown to the driver"
        raise HazardError(
            f"the base refuses to drive (cause: {causes}); free its wheels, try again"
        )

    def _catch_up(self) -> None:
        """Wait for fresh readings of a standing base that was not serviced: the program computed.

        Raises:
            HazardError, LinkError: See ``service``.
        """
        if self._moving or self._clock.now() - self._receiver.read_at <= UNSERVICED:
            return
        before = self._readings.latest
        self.service(self._clock.now())
        while self._readings.latest is before:
            self._clock.sleep(oi.PERIOD / 3)
            self.service(self._clock.now())

    def _drive(self, right_mm: int, left_mm: int) -> None:
        self._sent = (right_mm, left_mm)
        self._sent_at = self._clock.now()
        self._orders.send(self._sent, self._sent_at)
        self._heartbeat.beat(self._moving)
        # While the base is called back it hears a stop at once, a drive command after the call.
        if not self._moving:
            self._inquiry.return_to_baud()
        if not self._inquiry.is_calling_back:
            self._transport.write(oi.drive_direct(right_mm, left_mm))
        self._readings.drive(self._sent_at, right_mm, left_mm)

    # Watching.

    def _check_hazards(self, before: Hazards, now: float) -> None:
        """Stop for hazards; repeat a drive command that the base did not receive."""
        # Collect the reasons to stop
        self._safe_at = now if self._readings.is_safe() else self._safe_at
        names = list(blocking_hazards(before, self.hazards(), sum(self._sent)))
        if self._moving and self.hazards().battery < LOW_BATTERY:
            names.append(f"low battery ({self.hazards().battery:.0%})")
        since = now - self._sent_at
        if self._moving and not self._readings.is_safe() and since > 3 * self.spec.sample_period:
            names += self._restore_safe_mode(now)

        # Stop, or repeat the command
        if names:
            self._drive(0, 0)
            raise HazardError(f"stopped: {', '.join(dict.fromkeys(names))} at {now:.2f} s")
        self._repeat_order(now)

    def _repeat_order(self, now: float) -> None:
        """Repeat a drive command that the base does not follow, or one from before Safe mode."""
        if self._resumes and self._readings.is_safe():
            self._resumes = False
            self._drive(*self._sent)
            return
        reported = self._readings.requested_speeds
        remedy = self._orders.check(reported, now, is_safe=self._readings.is_safe())
        if remedy == "none":
            return
        if remedy == "complete and repeat":
            self._orders.excuse(self._inquiry.complete_command())
        self._drive(*self._sent)

    def _wait_for_the_plug(self) -> None:
        """Wait until an unplugged base is back, and stop it; driving resumes once it answers.

        Raises:
            LinkError: It is not plugged in again within ``MAX_OUTAGE``.
        """
        if self._waiting:
            return  # re-entered through the clock, which services the lidar meanwhile

        # Wait for the port
        self._waiting = True
        deadline = self._clock.now() + MAX_OUTAGE
        try:
            while is_away(self._transport):
                if self._clock.now() >= deadline:
                    raise LinkError(
                        f"the base has been unplugged for {MAX_OUTAGE:.0f} s"
                        + ("; it may still be driving: lift it" if self._moving else "")
                    )
                self._clock.sleep(ASK_AGAIN)
                self._transport.read(0.0)
        finally:
            self._waiting = False

        # Stop the wheels
        now = self._clock.now()
        self._receiver.resume(now)
        self._heartbeat.interrupt()
        self._halt(now, "the base was unplugged")

    def _restore_safe_mode(self, now: float) -> list[str]:
        """Return why the base left Safe mode; after a halt, request Safe mode instead.

        On a noisy link a garbled command may be the cause: then the base is halted for it.
        """
        why = find_unsafe_causes(self._readings.values, self.hazards())
        unknown = not (self.hazards().active() or self.charging)
        was_safe = now - self._safe_at < LOST_AFTER / 2 and now - self._halted_at > LOST_AFTER
        if unknown and was_safe and self._readings.filter.is_noisy(now):
            self._halt(now, "a garbled command took the base out of Safe mode")
        if not (unknown and now - self._halted_at < LOST_AFTER):
            return why
        if now > self._inquiry.again_at:
            self._transport.write(oi.command(Op.SAFE))
            self._inquiry.again_at, self._resumes = now + ASK_AGAIN, True
        return []

    def _check_silence(self, now: float) -> None:
        """Stop and raise if the base stays silent; before that, request its packets again."""
        silent = now - self._inquiry.heard

        # Ask again, or halt
        if not self._moving and silent > self._patience and now > self._inquiry.again_at:
            self._inquiry.wake(now)
        if self._moving and silent > SILENCE and now > self._inquiry.again_at:
            if now - self._halted_at <= LOST_AFTER and not self._inquiry.has_called:
                self._inquiry.call_back(now)
            else:
                self._halt(now, f"the base has not answered for {silent:.2f} s")

        # Give up
        if self._inquiry.is_lost(now, self._moving):
            self._inquiry.heard = now
            drove = self._moving
            self._inquiry.return_to_baud()
            self._drive(0, 0)
            words = f"the base has been silent for {silent:.1f} s; check its cable and battery"
            if reason := self._readings.reason:
                usable = f"no reading of the base was usable for {silent:.1f} s"
                words = f"{usable} ({reason}); check its cable"
            raise HazardError(f"stopped: {words}") if drove else LinkError(words)

    def _halt(self, now: float, why: str) -> None:
        """Stop the wheels; drive on if the base answers in Safe mode within ``LOST_AFTER``."""
        if now - self._halted_at > LOST_AFTER:
            log.warning("halted for a moment: %s", why)
        self._inquiry.return_to_baud()
        self._transport.write(STOP)
        self._readings.drive(now, 0, 0)
        self._inquiry.ask_anew()
        self._sent_at = self._halted_at = now
        self._inquiry.again_at = now + ASK_AGAIN

    def _read_at_rest(self, now: float) -> None:
        """On a Create 1 at rest, read packets 19 and 20 once."""
        stands = not self._moving and now - self._sent_at > STOPPING_TIME
        is_watched = self._inquiry.packets == watched_packets(self.contact)
        if stands and is_watched and self._readings.has_unread_motion:
            self._inquiry.ask(packets_at_rest(self.contact))

    def _keep_awake(self, now: float) -> None:
        """Repeat the request to a base that streams in Passive, before it falls asleep."""
        if self.mode is Mode.PASSIVE and not is_away(self._transport):
            self._inquiry.keep_awake(now)
