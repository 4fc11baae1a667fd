"""One URG-04LX with its quirks, and the stream it may be sending."""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.codec import ScanRequest


@dataclass(frozen=True, slots=True)
class UrgProfile:
    """One URG-04LX and its firmware's quirks.

    Attributes:
        usb: Connected by USB, where the bit rate means nothing.
        baud: Bit rate when powered up [bit/s].
        scip1: Speaks SCIP 1.1 with the laser on when powered up, the factory's default for many.
        firmware: Version.
        tick: Requests are answered once per this time [s]; 0 is at once.
        boot: Silence after power-up while the motor gets up to speed [s]; assumption.
        timer_ms: The timer at time 0 [ms].
        skew: How much too fast its clock runs (0.004 in the capture).
        knows_38400: Whether SS accepts 38400.
        faulty_version: VV has a stray line and a wrong sum on ``SERI``.
        mute_on_multiecho: Requests for several echoes silence it until it is powered up again, as
            users of urg_c report; otherwise they are unknown requests.
    """

    usb: bool = True
    baud: int = 19200
    scip1: bool = False
    firmware: tuple[int, int, int] = (3, 1, 4)
    tick: float = urg04lx.COMMAND_TICK
    boot: float = 3.0
    timer_ms: int = 0
    skew: float = 0.0
    knows_38400: bool = True
    faulty_version: bool = False
    mute_on_multiecho: bool = False


@dataclass
class Stream:
    """A running MD or MS.

    Attributes:
        request: What was asked for.
        since: Turns that began earlier are not sent [s].
        remaining: Scans still to come; None is without end.
        skipped: Turns left out since the last scan.
    """

    request: ScanRequest
    since: float
    remaining: int | None
    skipped: int = 10
