"""Choice of the scan mode: which scans fit which bit rate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from scan3d_twin.core.errors import ConfigError, LinkError
from scan3d_twin.devices.links.line_format import BITS_PER_BYTE
from scan3d_twin.devices.urg import codec as scip
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.codec import ScanCommand, ScanRequest
from scan3d_twin.devices.urg.model import ScanMode
from scan3d_twin.devices.urg.replies import scan_length

_COMMANDS: tuple[ScanCommand, ...] = ("MD", "MS")
"""Streams to try: three characters per step, then two, which reach the data sheet's 4095 mm."""
MAX_CLUSTER = 4
"""Largest cluster chosen automatically to keep the line rate: 1.4 deg; assumption."""


def scan_requests(mode: ScanMode | None, cluster: int | None = None) -> tuple[ScanRequest, ...]:
    """Return the streams that deliver ``mode``, the best first.

    Args:
        mode: Which steps to read, and how often; None is every turn, with all steps or as many
            around the front as a bit rate carries.
        cluster: Steps merged into one; None is as few as needed.

    Raises:
        ConfigError: There is no such stream.
    """
    # Without a mode: every turn, the widest window first
    if mode is None:
        cluster = 1 if cluster is None else cluster
        full = ScanMode(urg04lx.FIRST_STEP, urg04lx.LAST_STEP, 1)
        windows = [window(baud, cluster) for baud in (115200, 57600, 38400, 19200)]
        modes = [full, *(window for window in windows if window != full)]
        return tuple(request for mode in modes for request in scan_requests(mode, cluster))

    # Without a cluster: the smallest first
    if cluster is None:
        some = range(1, min(MAX_CLUSTER, len(mode.steps)) + 1 if mode.steps else 2)
        return tuple(request for size in some for request in scan_requests(mode, size))

    # Check the values
    low, high = urg04lx.FIRST_STEP, urg04lx.LAST_STEP
    if not low <= mode.first_step <= mode.last_step <= high:
        raise ConfigError(
            f"lidar steps must be within {low} to {high}, got {mode.first_step} to {mode.last_step}"
        )
    if not (1 <= cluster <= 99 and 1 <= mode.turns_per_line <= 10):
        raise ConfigError(
            f"cluster must be 1 to 99 and turns per line 1 to 10, got {cluster} and "
            f"{mode.turns_per_line}"
        )

    # One stream per encoding
    skip = mode.turns_per_line - 1
    return tuple(
        ScanRequest(command, mode.first_step, mode.last_step, cluster, skip)
        for command in _COMMANDS
    )


def window(baud: int, cluster: int = 1) -> ScanMode:
    """Return the widest window around the front that ``baud`` carries every turn.

    Raises:
        ConfigError: It carries none.
    """
    front = urg04lx.FRONT_STEP
    for half in range(front - urg04lx.FIRST_STEP, 0, -1):
        last = min(front + half, urg04lx.LAST_STEP)
        request = ScanRequest("MD", front - half, last, cluster)
        if duration(request, baud) <= period(request):
            return ScanMode(front - half, last, 1)
    raise ConfigError(f"{baud} baud carry no scan every turn")


def duration(request: ScanRequest, baud: int) -> float:
    """Return the transmission time of a scan at ``baud`` bit/s [s]."""
    return scan_length(request) * BITS_PER_BYTE / baud


def period(request: ScanRequest) -> float:
    """Return the time between two scans of the stream [s]."""
    return (request.skip + 1) * urg04lx.REVOLUTION


def choices(
    requests: Iterable[ScanRequest], current: int, bauds: Iterable[int] = scip.BAUDS
) -> Iterator[tuple[ScanRequest, int]]:
    """Yield (request, bit rate) that fit, the best first.

    For each request the ``current`` bit rate comes first, then the others, the slowest first.
    """
    order = [current, *sorted(set(bauds) - {current})]
    for request in requests:
        for baud in order:
            if duration(request, baud) <= period(request):
                yield request, baud


def too_slow(request: ScanRequest, baud: int) -> LinkError:
    """Return the error that explains, with numbers, why ``request`` does not fit."""
    needed, there = duration(request, baud), period(request)
    steps = request.last - request.first + 1
    most = int(steps * there / needed)
    fits = next(b for b in scip.BAUDS if duration(request, b) <= there)
    merged = f", {request.cluster} merged into one," if request.cluster > 1 else ""
    return LinkError(
        f"{steps} steps{merged} take {1e3 * needed:.0f} ms at {baud} baud, but a line lasts "
        f"{1e3 * there:.0f} ms, and this port or lidar goes no faster: use {fits} baud, USB, about "
        f"{most} steps, or every {-int(-needed // urg04lx.REVOLUTION)}. turn"
    )
