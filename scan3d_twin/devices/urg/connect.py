"""Connecting to an URG-04LX in whatever state it was left: find, identify, set the bit rate.

Whatever its bit rate, protocol and mode, and even while it streams, ``find`` leaves the sensor
silent and in SCIP 2.0. Only requests that an URG-04LX knows are sent: requests for multiple echoes,
and repeated VV, are reported to mute it until the next power-up.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle

from scan3d_twin.core.errors import LinkError, LinkTimeoutError, ProtocolError
from scan3d_twin.devices.reconnecting import Steps
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.clock_sync import SensorClock
from scan3d_twin.devices.urg.codec import Request, ScanRequest
from scan3d_twin.devices.urg.link import UrgLink
from scan3d_twin.devices.urg.replies import (
    Block,
    Reply,
    decode_old_reply,
    decode_reply,
    decode_texts,
    decode_time,
    find_echo,
    is_data,
    salvage_texts,
)
from scan3d_twin.devices.urg.scan_modes import choices, too_slow

LISTEN_TIME = 0.15
"""Time to listen at each bit rate [s]: requests are answered on a tick of 0.1 s."""
SCAN_TIME = 1.4
"""Time to listen once a stream is recognised [s]: a full scan at 19200 baud takes 1.1 s."""
LIKELY_BAUDS = (115200, 19200, 57600, 38400, 250000, 500000, 750000)
"""Bit rates in the order they are tried, the most likely first [bit/s]."""
BAUD_SETTLE = 0.02
"""Time after its reply in which the sensor changes the bit rate [s]; assumption."""
FALLBACK_TIMEOUT = 1.2
"""Time to search for a sensor that does not answer at its new bit rate [s]."""
TIMER_READINGS = 4
"""Number of times the timer is read; the reading with the smallest delay is used."""

_log = logging.getLogger(__name__)
_QUIT, _TIME_OFF = Request("QT"), Request("TM", "2")


@dataclass(frozen=True, slots=True)
class UrgInfo:
    """The sensor's description of itself.

    Attributes:
        baud: Bit rate at which it was found [bit/s].
        version: Reply to VV by key, as far as readable: VEND, PROD, FIRM, PROT, SERI.
        parameters: Reply to PP by key: MODL, DMIN, DMAX, ARES, AMIN, AMAX, AFRT, SCAN.
        state: Reply to II by key, as far as readable: LASR, SCSP, MESM, SBPS, TIME, STAT.
    """

    baud: int
    version: dict[str, str]
    parameters: dict[str, str]
    state: dict[str, str]


def status_of(reply: Reply) -> str:
    """Return the status of ``reply``."""
    return reply.status


def find(link: UrgLink, deadline: float, bauds: Sequence[int] = LIKELY_BAUDS) -> Steps[int]:
    """Find and silence the sensor, and return its bit rate [bit/s].

    Raises:
        LinkError: It was not found before ``deadline`` [s].
    """
    refused: set[int] = set()
    for baud in cycle(bauds):
        if link.clock.now() >= deadline or len(refused) == len(set(bauds)):
            break

        # Try this bit rate
        try:
            link.set_baud(baud)
        except LinkError:
            refused.add(baud)
            continue
        if (yield from _stop_sensor(link, deadline)):
            return baud

    raise LinkError(
        f"no URG-04LX answers at {', '.join(map(str, sorted(set(bauds) - refused)))} baud: check "
        "its power (5 V), the cable, and that this is the lidar's port; it needs seconds to start"
    )


def _stop_sensor(link: UrgLink, last: float) -> Steps[bool]:
    """Silence the sensor, in SCIP 2.0; return whether it answers at this bit rate."""
    # The line feed ends what a wrong bit rate or a dead client left in the sensor's buffer
    link.send(b"\n" + _QUIT.encode())
    deadline, understood = link.clock.now() + LISTEN_TIME, False
    while link.clock.now() < min(deadline, last):
        # React to complete blocks
        for arrived in link.take():
            reaction = _choose_reaction(arrived.block)
            if reaction is None:
                return True
            if reaction:
                link.send(reaction)
            understood = understood or bool(reaction)
            deadline = max(deadline, link.clock.now() + 2 * LISTEN_TIME) if reaction else deadline

        # Wait for the end of a scan
        if not understood and any(map(is_data, link.unfinished)):
            understood = True
            deadline = link.clock.now() + SCAN_TIME
        yield
    return False


def _choose_reaction(block: Block) -> bytes | None:
    """Return the bytes to send in response to ``block``; None if the sensor has stopped.

    Raises:
        LinkError: The sensor is waiting for a firmware update.
    """
    # Decode a reply of SCIP 2.0
    try:
        reply = decode_reply(find_echo(block, _QUIT.echo) or find_echo(block, _TIME_OFF.echo))
    except ProtocolError:
        return _choose_reaction_scip1(block)

    # Leave the time mode, where all else is refused
    if reply.status == "0I":
        raise LinkError("the lidar is waiting for a firmware update: power it off and on")
    if reply.echo == _TIME_OFF.echo:
        return _QUIT.encode()
    return {"00": None, "0B": None, "0E": _TIME_OFF.encode() + _QUIT.encode()}.get(
        reply.status, b""
    )


def _choose_reaction_scip1(block: Block) -> bytes:
    for echo in (scip.SWITCH, _QUIT.echo):
        with suppress(ProtocolError):
            _, status, _ = decode_old_reply(find_echo(block, echo))
            if (echo, status) == (scip.SWITCH, "0"):
                return _QUIT.encode()
            if echo == _QUIT.echo:
                return scip.SWITCH.encode() + b"\n"
    return b""


def identify(link: UrgLink) -> Steps[UrgInfo]:
    """Read the sensor's parameters, version and state.

    Raises:
        LinkError: It is not an URG-04LX, or does not answer.
    """
    # Check that it is an URG-04LX
    parameters, _ = yield from link.ask(Request("PP"), decode_texts)
    for key, value in (
        ("ARES", urg04lx.STEPS_PER_TURN),
        ("AFRT", urg04lx.FRONT_STEP),
        ("AMIN", urg04lx.FIRST_STEP),
        ("AMAX", urg04lx.LAST_STEP),
    ):
        if parameters.get(key) != str(value):
            raise LinkError(
                f"this lidar is not an URG-04LX: {key} is {parameters.get(key)}, not {value} "
                f"({parameters.get('MODL', 'unknown model')})"
            )

    # Read version and state, if they can be read
    version: dict[str, str] = {}
    state: dict[str, str] = {}
    with suppress(LinkTimeoutError):
        version, _ = yield from link.ask(Request("VV"), salvage_texts, attempts=1)
    with suppress(LinkTimeoutError):
        state, _ = yield from link.ask(Request("II"), salvage_texts, attempts=1)
    return UrgInfo(link.baud, version, parameters, state)


def speed_up(link: UrgLink, requests: Sequence[ScanRequest]) -> Steps[ScanRequest]:
    """Set a bit rate that port and sensor support; return the best stream it can carry.

    Raises:
        LinkError: No stream fits; the message says what would.
    """
    failed: set[int] = set()
    for request, baud in choices(requests, link.baud):
        if baud in failed:
            continue
        if baud == link.baud or (yield from _change_baud(link, baud)):
            return request
        failed.add(baud)
    raise too_slow(requests[-1], link.baud)


def _change_baud(link: UrgLink, baud: int) -> Steps[bool]:
    """Change the bit rate to ``baud``; return whether port and sensor support it.

    If not, the bit rate stays as it was.

    Raises:
        LinkError: Both accept it, but then cannot communicate.
    """
    # Try the port first: a sensor at a rate the port cannot set is lost until power-up
    before = link.baud
    try:
        link.set_baud(baud)
    except LinkError:
        return False
    finally:
        link.set_baud(before)

    # Change the sensor, then the port
    status, _ = yield from link.ask(Request("SS", f"{baud:06d}"), status_of)
    if status not in ("00", "03"):
        return False
    yield from link.wait(BAUD_SETTLE)
    link.set_baud(baud)
    with suppress(LinkTimeoutError):
        yield from link.ask(_QUIT, status_of, attempts=2)
        return True

    # No answer: return to the bit rate before
    try:
        yield from find(link, link.clock.now() + FALLBACK_TIMEOUT, (before, *LIKELY_BAUDS))
    except LinkError:
        raise LinkError(
            f"the lidar went to {baud} baud as asked, but this port does not understand it there: "
            "power the lidar off and on, and choose a slower link or USB"
        ) from None
    return False


def synchronise(link: UrgLink, clock: SensorClock) -> Steps[None]:
    """Read the sensor's timer in its time mode, if the sensor supports that."""
    with suppress(LinkTimeoutError):
        yield from link.ask(Request("TM", "0"), status_of, attempts=1)
        for _ in range(TIMER_READINGS):
            time_ms, arrival = yield from link.ask(Request("TM", "1"), decode_time, attempts=1)
            clock.anchor(time_ms, arrival)
    yield from link.ask(_TIME_OFF, status_of)
