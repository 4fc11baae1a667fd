"""Serving emulated devices in real time: the only emulator code that reads the system clock."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links.scheduling import short_slices

SLICE = 0.005
"""Longest simulated time between two services of the ports [s]."""
LAG = 0.5
"""Longest delay of the simulation behind real time that is caught up [s]."""
LOST = 1.0
"""Real time lost between two warnings [s]."""

log = logging.getLogger(__name__)


class Port(Protocol):
    """The end of a line to which a client connects.

    Attributes:
        path: Path or URL for the client.
    """

    path: str

    def service(self, now: float) -> None:
        """Transfer the bytes of both directions up to ``now`` [s]."""
        ...


class Pace:
    """The delay of the simulation behind real time: up to ``LAG`` of it is caught up.

    Any further delay is lost: the simulation then runs slower than real time, with the timing of
    the bytes still correct in simulated time.

    Attributes:
        lost: Real time that the simulation has missed [s].
    """

    def __init__(self, now: float, wall: float) -> None:
        self.lost = 0.0
        self._reported = 0.0
        self._ahead = now - wall

    def behind(self, now: float, wall: float) -> float:
        """Return the delay of the simulation behind real time [s]; negative if it is ahead.

        Args:
            now: Simulated time [s].
            wall: Real time [s].
        """
        # Drop what cannot be caught up
        behind = wall + self._ahead - now
        if behind > LAG:
            self.lost += behind - LAG
            self._ahead -= behind - LAG
            behind = LAG

        # Warn each second lost
        if self.lost - self._reported >= LOST:
            self._reported = self.lost
            log.warning(
                "this computer is too busy: the emulated world has lost %.1f s so far; clients may "
                "find the devices slow or silent; end other programs",
                self.lost,
            )
        return behind


def serve(ports: Sequence[Port], clock: Clock, ended: Callable[[], bool] = lambda: False) -> None:
    """Serve ``ports`` in real time, as far as the computer is fast enough, until ``ended``.

    Args:
        ports: Ports of the emulated devices.
        clock: Clock of the simulation.
        ended: Returns whether to stop.
    """
    pace = Pace(clock.now(), time.monotonic())
    with short_slices():
        while not ended():
            behind = pace.behind(clock.now(), time.monotonic())
            if behind > 0:
                # The emulated base reports hazards in bytes.
                with suppress(HazardError):
                    clock.sleep(min(behind, SLICE))
            else:
                time.sleep(-behind)
            for port in ports:
                port.service(clock.now())
