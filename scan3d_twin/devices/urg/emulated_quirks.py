"""Settings of an emulated URG-04LX: its quirks, and its running stream."""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.codec import ScanRequest


@dataclass(frozen=True, slots=True)
class UrgProfile:
    """One URG-04LX and its firmware's quirks.

    Attributes:
        usb: Whether it is connected by USB, where the bit rate has no effect.
        baud: Bit rate after power-up [bit/s].
        scip1: Whether it powers up in SCIP 1.1 with the laser on, a common factory default.
        firmware: Firmware version.
        tick: Interval at which requests are answered [s]; 0 is at once.
        boot: Silence after power-up while the motor gets up to speed [s]; assumption.
        timer_ms: The timer at time 0 [ms].
        skew: Clock skew, positive if its clock is fast (0.004 in the capture).
        knows_38400: Whether SS accepts 38400.
        faulty_version: Whether the reply to VV has a stray line and a wrong checksum on ``SERI``.
        mute_on_multiecho: Whether a request for multiple echoes mutes it until the next power-up,
            as users of urg_c report; otherwise it is an unknown request.
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
    """A running stream (MD or MS).

    Attributes:
        request: The request that started it.
        since: Start time [s]; turns that began earlier are not sent.
        remaining: Scans still to be sent; None is without end.
        skipped: Turns since the last scan that was sent.
    """

    request: ScanRequest
    since: float
    remaining: int | None
    skipped: int = 10
