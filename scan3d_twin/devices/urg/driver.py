"""The driver of the URG-04LX: a ``Lidar`` over SCIP 2.0."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from scan3d_twin.core.errors import LinkError, LinkTimeoutError, ProtocolError
from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import IntArray
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.reconnecting import POLL, LinkStats, ReconnectingLidar, Steps
from scan3d_twin.devices.urg.clock_sync import SensorClock
from scan3d_twin.devices.urg.codec import Request, ScanRequest
from scan3d_twin.devices.urg.connect import (
    LIKELY_BAUDS,
    UrgInfo,
    find,
    identify,
    speed_up,
    status_of,
    synchronise,
)
from scan3d_twin.devices.urg.lines import line_spec, to_line
from scan3d_twin.devices.urg.link import Arrived, UrgLink
from scan3d_twin.devices.urg.model import ScanMode
from scan3d_twin.devices.urg.replies import (
    DONE,
    STREAMED,
    Block,
    decode_reply,
    decode_scan,
    find_echo,
)
from scan3d_twin.devices.urg.salvage import GarbledScan, salvage_scan, split_scans
from scan3d_twin.devices.urg.scan_modes import duration, period, scan_requests

CONNECT_TIMEOUT = 5.8
"""Time-out from opening the port to a running stream, in whatever state the sensor was left [s]."""
FIND_TIMEOUT = 3.5
"""Share of ``CONNECT_TIMEOUT`` for finding the sensor [s]: trying all bit rates takes 1.05 s, and
the sensor may still be starting."""
MAX_SCAN_GAP = 1.0
"""Time of listening without a good scan after which the stream is requested again [s]; it doubles
with each fruitless request, because a sensor may start its stream anew at each."""
MAX_BACKOFF = 4
"""Largest multiple of that time: 5.2 s at 10 Hz, the motor's start included; assumption."""
MAX_REQUESTS_SILENT = 2
"""Fruitless requests to a silent sensor after which the driver reconnects."""
MAX_REQUESTS = 5
"""Fruitless requests after which it reconnects although bytes still arrive."""
CLOSE_TIMEOUT = 0.5
"""Time-out for each request on closing [s]: two ticks, besides the scan in the line's buffer."""
USUAL_BAUDS = (19200, 57600, 115200)
"""Bit rates at which other programs look for the sensor [bit/s]."""

_log = logging.getLogger(__name__)


@dataclass
class UrgStats(LinkStats):
    """Statistics of the link, besides those of every lidar.

    Attributes:
        good: Scans received whole.
        garbled: Scans received with rows missing.
        lost_rows: Rows missing in those.
        bad: Blocks dropped, scans or others: wrong checksum, length or time.
        masked: Readings beyond the lidar's range, left out of their scans.
        reason: Why the last block was dropped.
    """

    good: int = 0
    garbled: int = 0
    lost_rows: int = 0
    bad: int = 0
    masked: int = 0
    reason: str = ""


class UrgLidar(ReconnectingLidar):
    """A ``Lidar``: an URG-04LX behind a transport.

    Attributes:
        info: The sensor's description of itself.
        request: The running stream.
    """

    stats: UrgStats
    info: UrgInfo
    request: ScanRequest

    def __init__(
        self,
        open_transport: Callable[[], Transport],
        clock: Clock,
        mode: ScanMode | None = None,
        cluster: int | None = None,
    ) -> None:
        """Connect and start the laser.

        Args:
            open_transport: Opens the port; called again after the sensor was unplugged.
            clock: The robot's clock; its ``sleep`` may service this lidar.
            mode: Which steps to read, and how often; None is as many as the line carries every
                turn.
            cluster: Steps merged into one reading, the shortest; None is the smallest number with
                which the line can carry ``mode``.

        Raises:
            ConfigError: There is no such mode.
            LinkError: There is no sensor, or it cannot deliver ``mode``; the message says why.
        """
        super().__init__(open_transport, clock)
        self._requests = scan_requests(mode, cluster)
        self.stats = UrgStats()

        # State of the connection
        self._bauds: tuple[int, ...] = LIKELY_BAUDS
        self._info: UrgInfo | None = None
        self._sensor_clock = SensorClock()
        self._link: UrgLink | None = None

        # Connect
        try:
            self._connect_first()
            self.spec = line_spec(self.request)
            if cluster is None and self.request.cluster > 1:
                _log.warning(
                    "the line is slow: %d steps are merged into one, %d readings a scan",
                    self.request.cluster,
                    self.request.n_values,
                )
        except BaseException:
            self.close()
            raise

    @property
    def bad(self) -> int:
        """Blocks that arrived damaged, scans or others."""
        return self.stats.bad + self.stats.garbled

    def _connect_first(self) -> None:
        deadline = self._clock.now() + CONNECT_TIMEOUT
        while not self._connected:
            if self._clock.now() >= deadline:
                raise LinkTimeoutError(
                    f"the lidar was not ready within {CONNECT_TIMEOUT:g} s, power it off and on: "
                    f"{self.stats.problem or 'it never fell silent'}"
                )
            next(self._work)
            if self._link is None:
                self._clock.sleep(POLL)
            else:
                self._link.pump(POLL)

    def _may_reconnect(self, error: LinkError) -> bool:
        """See ``ReconnectingLidar``; a sensor that was just switched on answers late."""
        return self._connected or isinstance(error, LinkTimeoutError)

    def _explain_missing_line(self) -> str:
        return self.stats.problem or self.stats.reason

    def _drop_link(self, error: LinkError) -> None:
        self._link = None
        super()._drop_link(error)

    def _scan(self) -> Steps[NoReturn]:
        """See ``ReconnectingLidar``."""
        link = yield from self._connect()
        nudges, looked = 0, self._clock.now()
        self._measure_absence()
        while True:
            # Discard what arrived while the program computed
            now = self._clock.now()
            if away := self._measure_absence():
                link.forget()
                looked += away

            # Take in what has arrived
            for arrived in link.take():
                self._take(arrived)

            # Request again after a silence
            gap = (MAX_SCAN_GAP + 3 * period(self.request)) * min(2**nudges, MAX_BACKOFF)
            if self._last_good > looked:
                nudges, looked = 0, self._last_good
            elif now - looked > gap:
                nudges, looked = nudges + 1, now
                self._request_again(link, nudges, silent=now - link.heard_at > gap / 2)
            yield

    def _request_again(self, link: UrgLink, nudges: int, *, silent: bool) -> None:
        """Request the stream again; a sensor that is streaming refuses and continues.

        Raises:
            LinkTimeoutError: There have been too many requests already.
        """
        why = f" ({self.stats.reason})" if self.stats.reason else ""
        self.stats.problem = "the lidar fell silent" if silent else f"no good scan arrives{why}"
        _log.warning("%s, asking again", self.stats.problem)
        if nudges > (MAX_REQUESTS_SILENT if silent else MAX_REQUESTS):
            raise LinkTimeoutError(f"{self.stats.problem}, {nudges} requests were fruitless")
        link.send(b"\n" + self.request.request().encode())

    def _connect(self) -> Steps[UrgLink]:
        """Open the port, find the sensor and start the stream."""
        # Find and identify the sensor
        self._transport = self._open_transport()
        link = self._link = UrgLink(self._transport, self._clock, self._bauds[0])
        deadline = self._clock.now() + FIND_TIMEOUT
        yield from find(link, deadline, self._bauds)
        found = link.baud
        if self._info is None:
            self._info = self.info = yield from identify(link)

        # Set the bit rate and synchronise the clocks
        self.request = yield from speed_up(link, self._requests)
        self._sensor_clock = SensorClock(self._sensor_clock.latency)
        if not self._connected:
            yield from synchronise(link, self._sensor_clock)

        # After a reconnect the lines must have the same shape, whatever the next port could carry
        same = (self.request.first, self.request.last, self.request.cluster)
        self._requests = tuple(r for r in self._requests if (r.first, r.last, r.cluster) == same)

        # Try the current bit rate first, then the one at which it was found
        self._bauds = tuple(dict.fromkeys((link.baud, found, *LIKELY_BAUDS)))

        # Start the stream
        yield from link.ask(self.request.request(), status_of)
        self.stats.reconnects += self._connected
        self._connected = True
        return link

    def _take(self, arrived: Arrived) -> None:
        """Keep the scans in a block that has arrived; count it as bad if there is none in it."""
        echo = self.request.request().echo
        parts = list(split_scans(arrived.block, echo))
        for part in parts:
            # Where something precedes the echo, only the arrival of the end is known
            began = arrived.began if part is parts[0] and part[0] == echo.encode() else None
            try:
                self._take_reply(part, began, arrived.ended)
            except ProtocolError as error:
                is_remains = arrived.is_cut or part is not parts[-1]
                self.stats.bad += not is_remains
                self.stats.reason = str(error)
                _log.debug("scan dropped: %s", error)

    def _take_reply(self, block: Block, began: float | None, ended: float) -> None:
        """Keep the scan in a reply.

        Args:
            block: The reply.
            began: Time at which it began to arrive [s]; None if that is not known.
            ended: Time by which it has arrived [s].

        Raises:
            ProtocolError: There is no scan, or its time is not known.
        """
        # Decode it, or what is left of it
        scan: GarbledScan
        longest = int(self.info.parameters["DMAX"])
        try:
            reply = decode_reply(find_echo(block, self.request.request().echo))
            if reply.status != STREAMED:
                if reply.status not in (DONE, "0B"):
                    _log.warning("the lidar reports status %s", reply.status)
                return
            whole = decode_scan(reply, self.request)
            scan = GarbledScan(whole.time_ms, whole.values, 0)
        except ProtocolError:
            scan = salvage_scan(block, self.request, longest)

        # Find its time
        clock = self._sensor_clock
        if scan.time_ms is not None and began is not None:
            stamp = clock.stamp(scan.time_ms, began)
        elif scan.time_ms is not None:
            stamp = clock.stamp_late(scan.time_ms, ended)
        elif began is not None:
            stamp = clock.stamp_by_turns(began, period(self.request))
        else:
            raise ProtocolError("a scan without a time, and its arrival is not known")

        # Count and store the line
        values = np.array(scan.values)
        self._count(scan, values, longest)
        self._last_good = self._clock.now()
        self._unread.append(to_line(stamp, values, longest))

    def _count(self, scan: GarbledScan, values: IntArray, longest: int) -> None:
        stats = self.stats
        stats.problem = stats.reason = ""
        is_garbled = scan.lost_rows > 0 or scan.time_ms is None
        stats.good += not is_garbled
        stats.garbled += is_garbled
        stats.lost_rows += scan.lost_rows

        # Name the first reading out of range
        beyond = np.flatnonzero(values > longest)
        if len(beyond) and not stats.masked:
            step = self.request.first + self.request.cluster * int(beyond[0])
            _log.warning(
                "the lidar reads %d mm at step %d, beyond its range of %d mm: such readings are "
                "left out",
                values[beyond[0]],
                step,
                longest,
            )
        stats.masked += len(beyond)

    def _leave_at_rest(self, transport: Transport) -> None:
        """Stop the laser, and return to a bit rate that other programs expect."""
        link = self._link
        if link is None or self._info is None:
            return
        self._send_and_wait(link, Request("QT"))
        usual = self._info.baud if self._info.baud in USUAL_BAUDS else 115200
        if usual != link.baud:
            self._send_and_wait(link, Request("SS", f"{usual:06d}"))

    def _send_and_wait(self, link: UrgLink, request: Request) -> None:
        """Send ``request`` and wait for its answer without sleeping on the robot's clock."""
        deadline = self._clock.now() + CLOSE_TIMEOUT + duration(self._requests[0], link.baud)
        link.send(b"\n" + request.encode())
        while self._clock.now() < deadline:
            if any(find_echo(arrived.block, request.echo) for arrived in link.take()):
                return
            link.pump(POLL)
