"""Finding out which lidar is on a port: first by listening, then by harmless questions."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

from scan3d_twin.core.errors import LinkError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.device import LidarProbe
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.registry import lidar_probes

PROBE_TIMEOUT = 5.5
"""Time after which the search is given up [s]: a URG-04LX that was just switched on is silent for
3 s (assumption)."""
POLL = 0.005
"""Longest wait for bytes before what has arrived is looked at [s]."""
MAX_BYTES = 8192
"""Bytes of one probe that are looked at: a tenth of a second at the fastest rate."""


def find_lidar(
    open_transport: Callable[[], Transport],
    clock: Clock,
    probes: tuple[LidarProbe, ...] | None = None,
) -> str:
    """Return the name of the lidar on a line, whatever state it is in.

    Families that send by themselves are listened for before anything is sent; each request is
    harmless to all others (``LidarProbe``). It may take a lidar seconds to start: all are tried
    again and again.

    Args:
        open_transport: Opens the line, on which there must be no base.
        clock: The time.
        probes: How lidars are recognised; None is those of all families.

    Raises:
        LinkError: The port cannot be opened, or none is recognised within ``PROBE_TIMEOUT``.
    """
    probes = lidar_probes() if probes is None else probes
    deadline, refused, heard = clock.now() + PROBE_TIMEOUT, set[int](), 0
    reason: str | None = None
    with closing(open_transport()) as line:
        while clock.now() < deadline:
            for probe in probes:
                for baud in probe.bauds:
                    if baud in refused or clock.now() >= deadline:
                        continue
                    try:
                        line.set_baud(baud)
                    except LinkError:
                        refused.add(baud)
                        continue
                    name, data = _try(line, clock, probe)
                    if name is not None:
                        return name
                    heard += len(data)
                    reason = (probe.explain(data) if probe.explain else None) or reason
    if reason is None:
        what = f"{heard} bytes arrive, but from none that is known" if heard else "no byte arrives"
        reason = f"{what}; check its power and its cable, or name it with --lidar"
    raise LinkError(f"no lidar was recognised within {PROBE_TIMEOUT:g} s: {reason} (twin devices)")


def _try(line: Transport, clock: Clock, probe: LidarProbe) -> tuple[str | None, bytes]:
    """Return the lidar that a ``probe`` recognises at the line's bit rate, and what was heard."""
    line.discard_input()
    if probe.stop:
        line.write(probe.stop)
        clock.sleep(probe.pause)
    if probe.request:
        line.write(probe.request)
    data, until = b"", clock.now() + probe.wait
    while clock.now() < until and len(data) < MAX_BYTES:
        arrived = line.read(POLL)
        data += arrived
        if arrived and (name := probe.recognise(data)):
            return name, data
    return None, data
