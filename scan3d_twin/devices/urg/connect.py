"""Finding an URG-04LX in whatever state it was left, and making it ready.

Whatever its bit rate, protocol and mode, and even while it streams, ``find`` ends with a silent
sensor that speaks SCIP 2.0. Nothing is sent that an URG-04LX does not know: requests for multiple
echoes, and VV again and again, are reported to silence it until it is powered up again.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import cycle

from scan3d_twin.core.errors import LinkError, LinkTimeoutError, ProtocolError
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.clock_sync import SensorClock
from scan3d_twin.devices.urg.codec import Request, ScanRequest
from scan3d_twin.devices.urg.link import Steps, UrgLink
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

PROBE = 0.15
"""How long to listen at each bit rate [s]: requests are answered on a tick of 0.1 s."""
DRAIN = 1.4
"""How long to go on when something was understood [s]: a whole scan at 19200 baud takes 1.1 s."""
ORDER = (115200, 19200, 57600, 38400, 250000, 500000, 750000)
"""Bit rates by likelihood; 19200 and 115200 are usual."""
SETTLE = 0.02
"""The sensor changes its bit rate after the reply [s]; assumption."""
FALLBACK = 1.2
"""How long to look for a sensor that is not heard at its new bit rate [s]."""
TIMES = 4
"""Readings of the timer; the earliest reply counts."""

_log = logging.getLogger(__name__)
_QUIT, _TIME_OFF = Request("QT"), Request("TM", "2")


@dataclass(frozen=True, slots=True)
class UrgInfo:
    """What a sensor says about itself.

    Attributes:
        baud: Bit rate at which it was found [bit/s].
        version: VV by key, as far as it could be read: VEND, PROD, FIRM, PROT, SERI.
        parameters: PP by key: MODL, DMIN, DMAX, ARES, AMIN, AMAX, AFRT, SCAN.
        state: II by key: LASR, SCSP, MESM, SBPS, TIME, STAT.
    """

    baud: int
    version: dict[str, str]
    parameters: dict[str, str]
    state: dict[str, str]


def status_of(reply: Reply) -> str:
    """Return the status of ``reply``."""
    return reply.status


def find(link: UrgLink, deadline: float, bauds: Sequence[int] = ORDER) -> Steps[int]:
    """Stop the sensor, whatever it does, and return the bit rate at which it listens.

    Raises:
        LinkError: It was not found before ``deadline`` [s].
    """
    refused: set[int] = set()
    for baud in cycle(bauds):
        if link.clock.now() >= deadline or len(refused) == len(set(bauds)):
            break
        try:
            link.set_baud(baud)
        except LinkError:
            refused.add(baud)
            continue
        if (yield from _stopped(link, deadline)):
            return baud
    raise LinkError(
        f"no URG-04LX answers at {', '.join(map(str, sorted(set(bauds) - refused)))} baud: check "
        "its power (5 V), the cable, and that this is the lidar's port; it needs seconds to start"
    )


def _stopped(link: UrgLink, last: float) -> Steps[bool]:
    """Return whether the sensor answers at this bit rate; it is silent and speaks SCIP 2.0 then."""
    # The line feed ends what a wrong bit rate or a dead client left in the sensor's buffer.
    link.send(b"\n" + _QUIT.encode())
    deadline, understood = link.clock.now() + PROBE, False
    while link.clock.now() < min(deadline, last):
        for arrived in link.take():
            reaction = _reaction(arrived.block)
            if reaction is None:
                return True
            if reaction:
                link.send(reaction)
            understood = understood or bool(reaction)
            deadline = max(deadline, link.clock.now() + 2 * PROBE) if reaction else deadline
        if not understood and any(map(is_data, link.unfinished)):
            understood = True
            deadline = link.clock.now() + DRAIN
        yield
    return False


def _reaction(block: Block) -> bytes | None:
    """Return what to send after ``block`` came; None if the sensor has stopped.

    Raises:
        LinkError: The sensor waits for a firmware update.
    """
    try:
        reply = decode_reply(find_echo(block, _QUIT.echo) or find_echo(block, _TIME_OFF.echo))
    except ProtocolError:
        return _reaction_scip1(block)
    if reply.status == "0I":
        raise LinkError("the lidar waits for a firmware update: power it off and on")
    if reply.echo == _TIME_OFF.echo:
        return _QUIT.encode()
    # In the time mode everything else is refused.
    return {"00": None, "0B": None, "0E": _TIME_OFF.encode() + _QUIT.encode()}.get(
        reply.status, b""
    )


def _reaction_scip1(block: Block) -> bytes:
    for echo in (scip.SWITCH, _QUIT.echo):
        with suppress(ProtocolError):
            _, status, _ = decode_old_reply(find_echo(block, echo))
            if (echo, status) == (scip.SWITCH, "0"):
                return _QUIT.encode()
            if echo == _QUIT.echo:
                return scip.SWITCH.encode() + b"\n"
    return b""


def identify(link: UrgLink) -> Steps[UrgInfo]:
    """Return what the sensor says about itself.

    Raises:
        LinkError: It is no URG-04LX, or says nothing.
    """
    parameters, _ = yield from link.ask(Request("PP"), decode_texts)
    for key, value in (
        ("ARES", urg04lx.STEPS_PER_TURN),
        ("AFRT", urg04lx.FRONT_STEP),
        ("AMIN", urg04lx.FIRST_STEP),
        ("AMAX", urg04lx.LAST_STEP),
    ):
        if parameters.get(key) != str(value):
            raise LinkError(
                f"this lidar is no URG-04LX: {key} is {parameters.get(key)}, not {value} "
                f"({parameters.get('MODL', 'unknown model')})"
            )
    version: dict[str, str] = {}
    state: dict[str, str] = {}
    with suppress(LinkTimeoutError):
        version, _ = yield from link.ask(Request("VV"), salvage_texts, attempts=1)
    with suppress(LinkTimeoutError):
        state, _ = yield from link.ask(Request("II"), salvage_texts, attempts=1)
    return UrgInfo(link.baud, version, parameters, state)


def speed_up(link: UrgLink, requests: Sequence[ScanRequest]) -> Steps[ScanRequest]:
    """Choose a bit rate that both sides manage, and return the stream that fits it.

    Raises:
        LinkError: None fits; says what would.
    """
    failed: set[int] = set()
    for request, baud in choices(requests, link.baud):
        if baud in failed:
            continue
        if baud == link.baud or (yield from _changed(link, baud)):
            return request
        failed.add(baud)
    raise too_slow(requests[-1], link.baud)


def _changed(link: UrgLink, baud: int) -> Steps[bool]:
    """Change the bit rate to ``baud`` and return whether both sides can; else it is as before.

    Raises:
        LinkError: Both said they can, but then do not understand each other.
    """
    before = link.baud
    # First the port alone: a sensor that went where the port cannot follow is lost until power-up.
    try:
        link.set_baud(baud)
    except LinkError:
        return False
    finally:
        link.set_baud(before)
    status, _ = yield from link.ask(Request("SS", f"{baud:06d}"), status_of)
    if status not in ("00", "03"):
        return False
    yield from link.wait(SETTLE)
    link.set_baud(baud)
    with suppress(LinkTimeoutError):
        yield from link.ask(_QUIT, status_of, attempts=2)
        return True
    try:
        yield from find(link, link.clock.now() + FALLBACK, (before, *ORDER))
    except LinkError:
        raise LinkError(
            f"the lidar went to {baud} baud as asked, but this port does not understand it there: "
            "power the lidar off and on, and choose a slower link or USB"
        ) from None
    return False


def synchronise(link: UrgLink, clock: SensorClock) -> Steps[None]:
    """Read the sensor's timer in its time mode, as far as it lets us."""
    with suppress(LinkTimeoutError):
        yield from link.ask(Request("TM", "0"), status_of, attempts=1)
        for _ in range(TIMES):
            time_ms, arrival = yield from link.ask(Request("TM", "1"), decode_time, attempts=1)
            clock.anchor(time_ms, arrival)
    yield from link.ask(_TIME_OFF, status_of)
