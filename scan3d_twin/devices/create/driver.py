"""The driver of the iRobot Create 1, Create 2 and Roomba 500 and 600: a ``DriveBase`` over bytes.

There are no threads: whoever waits calls ``service``. The base has no watchdog and keeps executing
its last drive command, so the driver stops it on every hazard and on every exit, and sends
heartbeats to a guard process.
"""

from __future__ import annotations

import logging
import math
from bisect import bisect_right
from contextlib import suppress
from dataclasses import replace

from scan3d_twin.core.errors import HazardError, LinkError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.navigation.wheel_kinematics import split_velocity
from scan3d_twin.core.types import Hazards, Odometry
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Model, Op
from scan3d_twin.devices.create.dead_reckoning import (
    CommandedReckoning,
    Reckoning,
    SampleTimes,
    make_reckoning,
)
from scan3d_twin.devices.create.hazards import blocking_hazards, decode_hazards, find_unsafe_causes
from scan3d_twin.devices.create.identification import find_base
from scan3d_twin.devices.create.link import (
    BAUDS,
    HALF_ANYTHING,
    HALF_DRIVE,
    MODE_SETTLE,
    Contact,
    Source,
    Stream,
    Values,
    base_spec,
    call_back,
    open_source,
    packets_at_rest,
    watched_packets,
)
from scan3d_twin.devices.create.order_watch import OrderWatch
from scan3d_twin.devices.create.packets import Mode, Packet
from scan3d_twin.devices.create.reading_filter import ReadingFilter
from scan3d_twin.devices.create.speed_watch import SpeedWatch
from scan3d_twin.devices.links.guard import Guard, NoGuard
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.links.transport import Transport, is_away

log = logging.getLogger(__name__)

SILENCE = 0.3
"""Silence of a driving base after which a stop is sent [s]; 20 periods."""
LOST_AFTER = 1.0
"""Silence of a driving base after which the link counts as lost [s]. If the base answers earlier,
only the computer or the cable was busy, and it drives on; assumption. Bytes that arrive from a base
that was called back are a sign of life, for up to ``FRAME_AT_LOWEST`` more."""
SILENCE_AT_REST = 3.0
"""Silence of a standing base after which the link counts as lost [s]; until then the driver keeps
requesting the stream."""
MAX_OUTAGE = 30.0
"""Time to wait for an unplugged base [s]: enough to fasten a plug; assumption."""
UNSERVICED = 0.25
"""Time without ``service`` after which the guard may have stopped a driving base [s]."""
GUARD_TIMEOUT = 0.3
"""Time without a heartbeat after which the guard stops the wheels [s]."""
MAX_HANG = 10.0
"""Time without ``service`` after which driving is not resumed [s]: by then nobody expects the robot
to move; assumption."""
ASK_AGAIN = 0.1
"""Time between two requests, and between two repetitions of a drive command [s]."""
FRAME_AT_LOWEST = 1.5
"""Time that a base called back from 300 bit/s may take to send the frame that it had begun [s]: 45
bytes."""
KEEP_AWAKE = 60.0
"""Time after which a base in Passive is sent its request again [s]: a Create 2 falls asleep after
five minutes without a command (manual); that a request counts as one is an assumption."""
CALL_AFTER_ASKS = 4
"""Unanswered requests before a standing base is called back from 300 bit/s."""
ASKS_AT_ONE_SPEED = 10
"""Unanswered requests before other baud rates are tried: noise may have changed the base's."""
LISTENING = 0.03
"""Longest time between two reads of the port that counts as listening [s]."""
STALE, STALE_IF_NOISY = 0.5, 0.1
"""Time after which bytes that wait for ``service`` are stale [s]; shorter on a noisy link, where
lost bytes make their age uncertain."""
STOPPING_TIME = 0.2
"""Time from a stop command until the wheels stand [s]; they decelerate with 1.8 m/s2."""
LOW_BATTERY = 0.1
"""State of charge below which the robot does not drive, 0..1; it must still find home."""
MIN_HISTORY = 20_000
"""Number of odometry samples always kept: 5 minutes."""
FORGET_BATCH = 2_000
"""Number of older samples deleted at a time."""
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
        contact: Model and baud rate of the base.
        mode: Mode that the base reports.
        spec: See ``DriveBase.spec``.
    """

    def __init__(self, transport: Transport, clock: Clock, contact: Contact, guard: Guard) -> None:
        # Device and port
        self.contact = contact
        self.mode = Mode.PASSIVE
        self._transport, self._clock, self._guard = transport, clock, guard
        self._header_summed: bool | None = None

        # Request the first packets
        self._heard = self._serviced = self._beat_at = clock.now()
        self._beat_gap, self._guarded = 0.0, False
        self._packets: tuple[Packet, ...] = ()
        self._source = self._ask(packets_at_rest(contact))
        self.spec = base_spec(contact.model, streams=isinstance(self._source, Stream))
        self._patience = ASK_AGAIN if isinstance(self._source, Stream) else 3 * ASK_AGAIN
        latency = oi.frame_size(self._packets) * BITS_PER_BYTE / contact.baud
        self._times = SampleTimes(self.spec.sample_period, latency)

        # State of commands and readings
        self._sent = (0, 0)
        self._sent_at = self._asked_at = -math.inf
        self._orders = OrderWatch(clock.now())
        self._speeds = SpeedWatch(contact.model)
        self._asks = 0
        self._halted_at = self._safe_at = -math.inf
        self._resumes = False
        self._waiting = self._is_calling_back = self._has_called = False
        self._stirred = -math.inf
        self._rejected, self._reason = 0, ""
        self._hazards, self._values = Hazards(), Values()
        self._history: list[Odometry] = []
        self._reckoning: Reckoning | None = None
        self._filter, self._gap = ReadingFilter(), False

        # Wait for the first reading
        while not self._history:
            clock.sleep(oi.PERIOD / 3)
            self._receive(clock.now())
            self._check_silence(clock.now())

    @property
    def bad(self) -> int:
        """Readings dropped since the packets were last requested, or by their values at all."""
        return self._source.bad + self._rejected

    @property
    def charging(self) -> bool:
        """Whether a charger is plugged in, or the base stands on its dock."""
        return bool(self._values.get(Packet.CHARGING_SOURCES))

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
        return self._history[-1]

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """See ``DriveBase.odometry_since``."""
        after = bisect_right(self._history, stamp, key=lambda sample: sample.stamp)
        return tuple(self._history[max(0, after - 1) :])

    def hazards(self) -> Hazards:
        """See ``DriveBase.hazards``."""
        return self._hazards

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
        before, away = self._hazards, now - self._serviced
        if self._moving and away > UNSERVICED and self._reckoning is not None:
            self._reckoning.drive(self._serviced + min(away, GUARD_TIMEOUT), 0.0, 0.0)
        fresh = self._receive(now)
        self._beat()
        hung, self._beat_gap = max(away, self._beat_gap), 0.0

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
            self._return_to_baud()
            self._transport.write(FAREWELL)
        self._sent = (0, 0)
        self._guard.beat(False)

    @property
    def _moving(self) -> bool:
        return self._sent != (0, 0)

    def _ask(self, packets: tuple[Packet, ...]) -> Source:
        self._packets, self._requested_at = packets, self._clock.now()
        self._heard = max(self._heard, self._requested_at - SILENCE / 2)
        return open_source(self._transport, self.contact, packets, self._header_summed)

    def _ask_anew(self) -> Source:
        """Request the same packets; unlike ``_ask``, this does not extend the time-out."""
        heard = self._heard
        source = self._ask(self._packets)
        self._heard = heard
        return source

    def _receive(self, now: float) -> bool:
        """Take in what has arrived; return whether there were readings."""
        # Discard stale bytes
        away = now - self._serviced
        if away > (STALE_IF_NOISY if self._filter.is_noisy(now) else STALE):
            self._transport.discard_input()
            if away > STALE and not self._moving:
                self._source = self._ask_anew()

        # Count only the time spent listening as silence
        unheard = max(0.0, away - LISTENING)
        self._heard = min(now, self._heard + unheard)
        self._stirred = min(now, self._stirred + unheard)
        self._serviced = now

        # Read, timestamp and take in
        data = self._transport.read(0.0)
        if data and self._has_called:
            self._stirred = now
        readings = self._source.take(data, now)
        self._gap |= self._filter.count_errors(self._source.errors, now)
        stamps = self._times.stamps(len(readings), now, gap=self._gap)
        for stamp, values in zip(stamps, readings, strict=True):
            self._gap = False
            self._take(stamp, now, values)
        return bool(readings)

    def _take(self, stamp: float, now: float, values: Values) -> None:
        """Take in one set of readings."""
        # Mask or reject impossible readings
        usable = self._filter.mask(values, self.contact, now)
        if usable is None:
            self._rejected, self._reason = self._rejected + 1, "a value is out of range"
            return
        values = usable

        # Debounce and update the odometry
        if self._reckoning is None:
            self._reckoning = make_reckoning(self.spec, stamp, values)
        doubtful = self._filter.is_noisy(now)
        believed = self._filter.take(values, now)
        odometry = self._reckoning.take(stamp, values, doubtful=doubtful)
        if odometry is not None:
            self._keep(odometry, now)
        else:
            self._rejected, self._reason = self._rejected + 1, "the wheel counts jump"
            if doubtful or not self._history:
                return

        # Store mode and hazards
        if not doubtful:
            self._speeds.take(self._sent, stamp, values)
        self._values = believed
        self.mode = Mode(believed[Packet.MODE] - self.contact.mode_offset)
        self._hazards = decode_hazards(believed)
        if isinstance(self._source, Stream):
            self._header_summed = self._source.header_summed

    def _keep(self, odometry: Odometry, now: float) -> None:
        self._heard, self._asks, self._reason, self._has_called = now, 0, "", False
        self._history.append(odometry)
        if len(self._history) > MIN_HISTORY + FORGET_BATCH:
            del self._history[:FORGET_BATCH]

    # Driving.

    def _prepare(self) -> None:
        """Prepare to drive: leave Passive, and on a Create 1 stop reading packets 19 and 20.

        Raises:
            HazardError: The base cannot drive, or does not enter Safe mode.
        """
        # Check charger, battery and packets
        self._catch_up()
        self._check_ready()
        if self._packets != watched_packets(self.contact):
            self._source = self._ask(watched_packets(self.contact))
        if self._is_safe():
            return

        # Request Safe mode until it is reported; where the cause is known, three times are enough
        asked, give_up = 0, self._clock.now() + LOST_AFTER
        while self._clock.now() < give_up and not (asked >= 3 and self._hazards.active()):
            asked += 1
            self._transport.write(oi.command(Op.SAFE))
            deadline = self._clock.now() + MODE_SETTLE + ASK_AGAIN
            self._clock.sleep(MODE_SETTLE)
            self.service(self._clock.now())
            while not self._is_safe() and self._clock.now() < deadline:
                self._clock.sleep(oi.PERIOD / 3)
                self.service(self._clock.now())
            if self._is_safe():
                return

        causes = ", ".join(self._hazards.active()) or "unknown to the driver"
        raise HazardError(
            f"the base refuses to drive (cause: {causes}); free its wheels, try again"
        )

    def _catch_up(self) -> None:
        """Wait for fresh readings of a standing base that was not serviced: the program computed.

        Raises:
            HazardError, LinkError: See ``service``.
        """
        if self._moving or self._clock.now() - self._serviced <= UNSERVICED:
            return
        before = self._history[-1]
        self.service(self._clock.now())
        while self._history[-1] is before:
            self._clock.sleep(oi.PERIOD / 3)
            self.service(self._clock.now())

    def _check_ready(self) -> None:
        """Raise ``HazardError`` if the base must not start driving."""
        if self.charging:
            raise HazardError("the base is on its charger: unplug it or take it off the dock")
        if self._hazards.battery < LOW_BATTERY:
            raise HazardError(f"low battery: {self._hazards.battery:.0%} left; charge the base")

    def _drive(self, right_mm: int, left_mm: int) -> None:
        self._sent = (right_mm, left_mm)
        self._sent_at = self._clock.now()
        self._orders.send(self._sent, self._sent_at)
        self._beat()
        # While the base is called back it hears a stop at once, a drive command after the call.
        if not self._moving:
            self._return_to_baud()
        if not self._is_calling_back:
            self._transport.write(oi.drive_direct(right_mm, left_mm))
        if self._reckoning is not None:
            linear, turn = (right_mm + left_mm) / 2000, (right_mm - left_mm) / 1000
            self._reckoning.drive(self._sent_at, linear, turn / self.spec.wheel_base)

    def _beat(self) -> None:
        """Send a heartbeat to the guard, and keep the longest time between two in a drive."""
        self._guard.beat(self._moving)
        now = self._clock.now()
        if self._guarded:
            self._beat_gap = max(self._beat_gap, now - self._beat_at)
        self._beat_at, self._guarded = now, self._moving

    # Watching.

    def _check_hazards(self, before: Hazards, now: float) -> None:
        """Stop for hazards; repeat a drive command that the base did not receive."""
        # Collect the reasons to stop
        self._safe_at = now if self._is_safe() else self._safe_at
        names = list(blocking_hazards(before, self._hazards, sum(self._sent)))
        if self._moving and self._hazards.battery < LOW_BATTERY:
            names.append(f"low battery ({self._hazards.battery:.0%})")
        since = now - self._sent_at
        if self._moving and not self._is_safe() and since > 3 * self.spec.sample_period:
            names += self._restore_safe_mode(now)

        # Stop, or repeat the command
        if names:
            self._drive(0, 0)
            raise HazardError(f"stopped: {', '.join(dict.fromkeys(names))} at {now:.2f} s")
        self._repeat_order(now)

    def _repeat_order(self, now: float) -> None:
        """Repeat a drive command that the base does not follow, or one from before Safe mode."""
        if self._resumes and self._is_safe():
            self._resumes = False
            self._drive(*self._sent)
            return
        remedy = self._orders.check(self._reported_speeds(), now, is_safe=self._is_safe())
        if remedy == "none":
            return
        if remedy == "complete and repeat":
            self._transport.write(HALF_ANYTHING)
            self._orders.excuse(len(HALF_ANYTHING) * BITS_PER_BYTE / self.contact.baud)
            self._source = self._ask_anew()
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
        self._heard = self._serviced = now = self._clock.now()
        self._guarded = False
        self._gap = True
        self._halt(now, "the base was unplugged")

    def _is_safe(self) -> bool:
        """Return whether the base obeys drive commands."""
        return self.mode >= Mode.SAFE

    def _restore_safe_mode(self, now: float) -> list[str]:
        """Return why the base left Safe mode; after a halt, request Safe mode instead.

        On a noisy link a garbled command may be the cause: then the base is halted for it.
        """
        why = find_unsafe_causes(self._values, self._hazards)
        unknown = not (self._hazards.active() or self.charging)
        was_safe = now - self._safe_at < LOST_AFTER / 2 and now - self._halted_at > LOST_AFTER
        if unknown and was_safe and self._filter.is_noisy(now):
            self._halt(now, "a garbled command took the base out of Safe mode")
        if not (unknown and now - self._halted_at < LOST_AFTER):
            return why
        if now > self._asked_at:
            self._transport.write(oi.command(Op.SAFE))
            self._asked_at, self._resumes = now + ASK_AGAIN, True
        return []

    def _reported_speeds(self) -> tuple[int, int]:
        """Return the commanded wheel speeds (right, left) that the base reports [mm/s]."""
        return self._values[Packet.REQUESTED_RIGHT], self._values[Packet.REQUESTED_LEFT]

    def _check_silence(self, now: float) -> None:
        """Stop and raise if the base stays silent; before that, request its packets again."""
        silent = now - self._heard

        # Ask again, or halt
        if not self._moving and silent > self._patience and now > self._asked_at:
            self._ask_again(now)
        if self._moving and silent > SILENCE and now > self._asked_at:
            if now - self._halted_at <= LOST_AFTER and not self._has_called:
                self._call_back(now)
            else:
                self._halt(now, f"the base has not answered for {silent:.2f} s")

        # Give up
        if self._is_lost(now):
            self._heard = now
            drove = self._moving
            self._return_to_baud()
            self._drive(0, 0)
            words = f"the base has been silent for {silent:.1f} s; check its cable and battery"
            if self._reason:
                words = (
                    f"no reading of the base was usable for {silent:.1f} s ({self._reason}); check "
                    "its cable"
                )
            raise HazardError(f"stopped: {words}") if drove else LinkError(words)

    def _is_lost(self, now: float) -> bool:
        """Return whether the base has been silent for too long.

        A driving base that was called back may still send, at another rate, what it had begun.
        """
        silent = now - self._heard
        if not self._moving:
            return silent > SILENCE_AT_REST
        dead = min(silent, now - self._stirred)
        return dead > LOST_AFTER or silent > LOST_AFTER + FRAME_AT_LOWEST

    def _halt(self, now: float, why: str) -> None:
        """Stop the wheels; drive on if the base answers in Safe mode within ``LOST_AFTER``."""
        if now - self._halted_at > LOST_AFTER:
            log.warning("halted for a moment: %s", why)
        self._return_to_baud()
        self._transport.write(STOP)
        if self._reckoning is not None:
            self._reckoning.drive(now, 0.0, 0.0)
        self._source = self._ask_anew()
        self._sent_at = self._halted_at = now
        self._asked_at = now + ASK_AGAIN

    def _call_back(self, now: float) -> None:
        """Order the base back from the rate that a garbled byte may have sent it to."""
        self._is_calling_back = self._has_called = True
        self._asked_at = now + call_back(self._transport, self.contact.baud)

    def _return_to_baud(self) -> None:
        """Speak again as before the base was called back."""
        if self._is_calling_back:
            self._is_calling_back = False
            self._transport.set_baud(self.contact.baud)

    def _ask_again(self, now: float) -> None:
        """Wake up a standing base that is silent: it may have missed or misread any command."""
        # Call it back once, between two requests
        if self._asks == CALL_AFTER_ASKS and not self._has_called:
            self._call_back(now)
            return
        self._return_to_baud()

        # Choose padding and baud rate
        self._asks += 1
        pad = HALF_ANYTHING
        if self._asks > ASKS_AT_ONE_SPEED:
            pad = HALF_DRIVE
            speed = BAUDS[(BAUDS.index(self.contact.baud) + 1) % len(BAUDS)]
            self.contact = replace(self.contact, baud=speed)
            self._transport.set_baud(speed)

        # Start and request the packets
        self._transport.write(pad + oi.command(Op.START))
        self._source = self._ask_anew()
        self._asked_at = now + ASK_AGAIN + len(pad) * BITS_PER_BYTE / self.contact.baud

    def _read_at_rest(self, now: float) -> None:
        """On a Create 1 at rest, read packets 19 and 20 once."""
        reckoning = self._reckoning
        if (
            isinstance(reckoning, CommandedReckoning)
            and reckoning.unread
            and not self._moving
            and now - self._sent_at > STOPPING_TIME
            and self._packets == watched_packets(self.contact)
        ):
            self._source = self._ask(packets_at_rest(self.contact))

    def _keep_awake(self, now: float) -> None:
        """Repeat the request to a base that streams in Passive, before it falls asleep."""
        is_due = now - self._requested_at > KEEP_AWAKE and isinstance(self._source, Stream)
        if is_due and self.mode is Mode.PASSIVE and not is_away(self._transport):
            self._transport.write(oi.stream(self._packets))
            self._requested_at = now
