"""The driver of the iRobot Create 1, Create 2 and Roomba 500 and 600: bytes to ``DriveBase``.

No threads: whoever waits calls ``service``. The base obeys its last drive command for ever, so the
driver stops it on every hazard and every way out, and tells a guard process that it is alive.
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
from scan3d_twin.devices.create.codec import Op
from scan3d_twin.devices.create.dead_reckoning import (
    CommandedReckoning,
    Reckoning,
    SampleTimes,
    make_reckoning,
)
from scan3d_twin.devices.create.hazards import blocking, hazards_of, why_not_safe
from scan3d_twin.devices.create.link import (
    BAUDS,
    HALF_ANYTHING,
    HALF_DRIVE,
    MODE_SETTLE,
    Contact,
    Source,
    Stream,
    Values,
    at_rest,
    base_spec,
    find_base,
    open_source,
    plausible,
    watched,
)
from scan3d_twin.devices.create.packets import Mode, Packet
from scan3d_twin.devices.create.reading_filter import ReadingFilter
from scan3d_twin.devices.links.guard import Guard, NoGuard
from scan3d_twin.devices.links.transport import Transport, is_away

log = logging.getLogger(__name__)

SILENCE = 0.3
"""A base that is silent for so long while it drives is told to stop [s]; 20 periods."""
LOST = 1.0
"""One that is silent for so long although it drove is lost [s]; if it speaks again before, it was
the computer or the cable that was busy, and it drives on; assumption."""
SILENCE_AT_REST = 3.0
"""One that stands is lost after this [s]; its stream is asked for again meanwhile."""
OUTAGE = 30.0
"""An unplugged base is waited for so long [s]: time to fasten a plug; assumption."""
HANG = 0.25
"""Nobody has serviced a base that drives for so long: the guard has stopped it, or will [s]."""
GUARDED = 0.3
"""After so long without a sign of life the guard stops the wheels [s]."""
HUNG = 10.0
"""A program that hung for longer does not drive on [s]: nobody expects the robot to; assumption."""
ASK_AGAIN = 0.1
"""Time between two such requests, and between two repeated drive commands [s]."""
ASKS_AT_ONE_SPEED = 10
"""Requests in vain before other speeds are tried: garbage may have changed the base's."""
LISTENING = 0.03
"""Longest time between two looks at the port that counts as listening [s]."""
AWAY, AWAY_IN_DOUBT = 0.5, 0.1
"""Bytes that waited longer than this for ``service`` are stale [s]: on a line that garbles them
nobody can tell from their number how old they are."""
REST = 0.2
"""The wheels stand so long after the command [s]; they slow down with 1.8 m/s2."""
LOW_BATTERY = 0.1
"""Share of charge below which the robot does not drive; it must still find home."""
HISTORY = 20_000
"""Odometry samples that are kept at least: 5 minutes."""
SURPLUS = 2_000
"""So many older ones are forgotten at a time."""
STOP = oi.drive_direct(0, 0)
FAREWELL = STOP + oi.command(Op.PAUSE_RESUME, 0) + oi.command(Op.START)
"""Wheels stopped, line silent, mode Passive: the base may charge and sleep again."""


def open_create(transport: Transport, clock: Clock, guard: Guard | None = None) -> CreateBase:
    """Return the base on the line, standing and in mode Passive.

    Raises:
        LinkTimeoutError: There is none.
    """
    contact = find_base(transport, clock)
    return CreateBase(transport, clock, contact, NoGuard() if guard is None else guard)


class CreateBase:
    """A ``DriveBase`` on a serial line; made by ``open_create``."""

    def __init__(self, transport: Transport, clock: Clock, contact: Contact, guard: Guard) -> None:
        self.contact = contact
        self.mode = Mode.PASSIVE
        self._transport, self._clock, self._guard = transport, clock, guard
        self._summed: bool | None = None
        self._heard = self._serviced = clock.now()
        self._packets: tuple[Packet, ...] = ()
        self._source = self._ask(at_rest(contact))
        self.spec = base_spec(contact.model, streams=isinstance(self._source, Stream))
        self._patience = ASK_AGAIN if isinstance(self._source, Stream) else 3 * ASK_AGAIN
        latency = oi.frame_size(self._packets) * 10 / contact.baud
        self._times = SampleTimes(self.spec.sample_period, latency)
        self._sent = (0, 0)
        self._sent_at = self._asked_at = -math.inf
        self._asks = 0
        self._halted_at = -math.inf
        self._waiting = False
        self._hazards, self._values = Hazards(), Values()
        self._history: list[Odometry] = []
        self._reckoning: Reckoning | None = None
        self._sieve, self._gap = ReadingFilter(), False
        while not self._history:
            clock.sleep(oi.PERIOD / 3)
            self._receive(clock.now())
            self._listen(clock.now())

    @property
    def bad(self) -> int:
        """Readings that were dropped since the packets were asked for last."""
        return self._source.bad

    @property
    def charging(self) -> bool:
        """Whether a charger is plugged in, or the base stands on its dock."""
        return bool(self._values.get(Packet.CHARGING_SOURCES))

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """See ``DriveBase.set_velocity``.

        Raises:
            HazardError: The base cannot drive: charger, battery, or it refuses Safe mode.
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
            HazardError: A new hazard, or the robot drives on into an old one, or the base is silent
                while it drives; the wheels stand.
            LinkError: The base is silent while it stands, or the port is gone.
        """
        if is_away(self._transport):
            self._wait_for_the_plug()
            return
        before, away = self._hazards, now - self._serviced
        hung = self._moving and away > HANG
        if hung and self._reckoning is not None:
            self._reckoning.drive(self._serviced + min(away, GUARDED), 0.0, 0.0)
        fresh = self._receive(now)
        self._guard.beat(self._moving)
        if self._moving and away > HUNG:
            self._drive(0, 0)
            raise HazardError(
                f"stopped: this program hung for {away:.1f} s while the robot drove (the guard "
                "stopped it meanwhile); end other programs"
            )
        if hung:
            self._halt(now)
        if fresh:
            self._watch(before, now)
        self._listen(now)
        self._rest(now)

    def close(self) -> None:
        """Stop the wheels and leave the base in mode Passive; the port stays open."""
        with suppress(LinkError):
            self._transport.write(FAREWELL)
        self._sent = (0, 0)
        self._guard.beat(False)

    @property
    def _moving(self) -> bool:
        return self._sent != (0, 0)

    def _ask(self, packets: tuple[Packet, ...]) -> Source:
        self._packets = packets
        self._heard = max(self._heard, self._clock.now() - SILENCE / 2)
        return open_source(self._transport, self.contact, packets, self._summed)

    def _ask_anew(self) -> Source:
        """Ask for the same; asking is not hearing."""
        heard = self._heard
        source = self._ask(self._packets)
        self._heard = heard
        return source

    def _receive(self, now: float) -> bool:
        """Take in what has arrived; tell whether there were readings."""
        away = now - self._serviced
        if away > (AWAY_IN_DOUBT if self._sieve.doubts(now) else AWAY):
            self._transport.discard_input()
        # Who does not listen hears nothing: only the time in which we listened counts.
        self._heard = min(now, self._heard + max(0.0, away - LISTENING))
        self._serviced = now
        readings = self._source.take(self._transport.read(0.0), now)
        self._gap |= self._sieve.line(self._source.broken, now)
        stamps = self._times.stamps(len(readings), now, gap=self._gap)
        for stamp, values in zip(stamps, readings, strict=True):
            self._gap = False
            self._take(stamp, now, values)
        return bool(readings)

    def _take(self, stamp: float, now: float, values: Values) -> None:
        """Take in one set of readings."""
        if not plausible(values, self.contact):
            return
        if self._reckoning is None:
            self._reckoning = make_reckoning(self.spec, stamp, values)
        doubtful = self._sieve.doubts(now)
        believed = self._sieve.take(values, now)
        odometry = self._reckoning.take(stamp, values, doubtful=doubtful)
        if odometry is not None:
            self._keep(odometry, now)
        elif doubtful or not self._history:
            return
        self._values = believed
        self.mode = Mode(believed[Packet.MODE] - self.contact.mode_offset)
        self._hazards = hazards_of(believed)
        if isinstance(self._source, Stream):
            self._summed = self._source.header_summed

    def _keep(self, odometry: Odometry, now: float) -> None:
        self._heard, self._asks = now, 0
        self._history.append(odometry)
        if len(self._history) > HISTORY + SURPLUS:
            del self._history[:SURPLUS]

    # Driving.

    def _prepare(self) -> None:
        """Get ready to drive: out of Passive, and on a Create 1 away from packets 19 and 20."""
        self._refuse()
        if self._packets != watched(self.contact):
            self._source = self._ask(watched(self.contact))
        if self._safe():
            return
        for _ in range(3):
            self._transport.write(oi.command(Op.SAFE))
            deadline = self._clock.now() + MODE_SETTLE + 3 * self.spec.sample_period
            self._clock.sleep(MODE_SETTLE)
            while self._clock.now() < deadline:
                self.service(self._clock.now())
                if self._safe():
                    return
                self._clock.sleep(oi.PERIOD / 3)
        causes = ", ".join(self._hazards.active()) or "unknown to the driver"
        raise HazardError(
            f"the base refuses to drive (cause: {causes}); free its wheels, try again"
        )

    def _refuse(self) -> None:
        """Raise for what forbids to drive off."""
        if self.charging:
            raise HazardError("the base is on its charger: unplug it or take it off the dock")
        if self._hazards.battery < LOW_BATTERY:
            raise HazardError(f"low battery: {self._hazards.battery:.0%} left; charge the base")

    def _drive(self, right_mm: int, left_mm: int) -> None:
        self._sent = (right_mm, left_mm)
        self._sent_at = self._clock.now()
        self._guard.beat(self._moving)
        self._transport.write(oi.drive_direct(right_mm, left_mm))
        if self._reckoning is not None:
            linear, turn = (right_mm + left_mm) / 2000, (right_mm - left_mm) / 1000
            self._reckoning.drive(self._sent_at, linear, turn / self.spec.wheel_base)

    # Watching.

    def _watch(self, before: Hazards, now: float) -> None:
        """Stop for hazards, and repeat what the base did not understand."""
        names = list(blocking(before, self._hazards, sum(self._sent)))
        if self._moving and self._hazards.battery < LOW_BATTERY:
            names.append(f"low battery ({self._hazards.battery:.0%})")
        since = now - self._sent_at
        if self._moving and not self._safe() and since > 3 * self.spec.sample_period:
            names += self._make_safe(now)
        if names:
            self._drive(0, 0)
            raise HazardError(f"stopped: {', '.join(dict.fromkeys(names))} at {now:.2f} s")
        if self._told() != self._sent and since > ASK_AGAIN and self._safe():
            self._drive(*self._sent)

    def _wait_for_the_plug(self) -> None:
        """Wait until an unplugged base is there again, and stop it then; it drives on later.

        Raises:
            LinkError: It stays away.
        """
        if self._waiting:
            return  # the lidar is looked after meanwhile
        self._waiting = True
        deadline = self._clock.now() + OUTAGE
        try:
            while is_away(self._transport):
                if self._clock.now() >= deadline:
                    raise LinkError(
                        f"the base has been unplugged for {OUTAGE:.0f} s"
                        + ("; it may still be driving: lift it" if self._moving else "")
                    )
                self._clock.sleep(ASK_AGAIN)
                self._transport.read(0.0)
        finally:
            self._waiting = False
        self._heard = self._serviced = now = self._clock.now()
        self._gap = True
        self._halt(now)

    def _safe(self) -> bool:
        """Tell whether the base would obey drive commands."""
        return self.mode >= Mode.SAFE

    def _make_safe(self, now: float) -> list[str]:
        """Return why the base left Safe mode; after a halt ask it back there instead."""
        why = why_not_safe(self._values, self._hazards)
        unknown = not (self._hazards.active() or self.charging)
        if not (unknown and now - self._halted_at < LOST):
            return why
        if now > self._asked_at:
            self._transport.write(oi.command(Op.SAFE))
            self._asked_at = now + ASK_AGAIN
        return []

    def _told(self) -> tuple[int, int]:
        """Return the wheel speeds (right, left) that the base says it was told [mm/s]."""
        return self._values[Packet.REQUESTED_RIGHT], self._values[Packet.REQUESTED_LEFT]

    def _listen(self, now: float) -> None:
        """Stop and raise if the base is silent; at rest ask again meanwhile."""
        silent = now - self._heard
        if not self._moving and silent > self._patience and now > self._asked_at:
            self._ask_again(now)
        if self._moving and silent > SILENCE and now > self._asked_at:
            self._halt(now)
        if silent > (LOST if self._moving else SILENCE_AT_REST):
            self._heard = now
            drove = self._moving
            self._drive(0, 0)
            words = f"the base has been silent for {silent:.1f} s; check its cable and battery"
            raise HazardError(f"stopped: {words}") if drove else LinkError(words)

    def _halt(self, now: float) -> None:
        """Stop the wheels, but drive on if the base speaks, and is safe, before it is lost."""
        if now - self._halted_at > LOST:
            log.warning("halted: the base, its cable or this computer was too busy")
        self._transport.write(STOP)
        if self._reckoning is not None:
            self._reckoning.drive(now, 0.0, 0.0)
        self._source = self._ask_anew()
        self._sent_at = self._halted_at = now
        self._asked_at = now + ASK_AGAIN

    def _ask_again(self, now: float) -> None:
        """Make a base speak that stands and is silent: it may have missed or misread anything."""
        self._asks += 1
        pad = HALF_ANYTHING
        if self._asks > ASKS_AT_ONE_SPEED:
            pad = HALF_DRIVE
            speed = BAUDS[(BAUDS.index(self.contact.baud) + 1) % len(BAUDS)]
            self.contact = replace(self.contact, baud=speed)
            self._transport.set_baud(speed)
        self._transport.write(pad + oi.command(Op.START))
        self._source = self._ask_anew()
        self._asked_at = now + ASK_AGAIN + len(pad) * 10 / self.contact.baud

    def _rest(self, now: float) -> None:
        """On a Create 1 that stands, read how far it went."""
        reckoning = self._reckoning
        if (
            isinstance(reckoning, CommandedReckoning)
            and reckoning.unread
            and not self._moving
            and now - self._sent_at > REST
            and self._packets == watched(self.contact)
        ):
            self._source = self._ask(at_rest(self.contact))
