"""Serving emulated devices in real time: the only place in ``emulator`` that knows the time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Protocol

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.hal import Clock

SLICE = 0.005
"""The world is let run this far between two looks at the ports [s]."""
LAG = 0.5
"""A computer that is slower than the world is not made to catch up with more [s]."""
LOST = 1.0
"""Each time so much more of the wall's time was lost, the user is told [s]."""

log = logging.getLogger(__name__)


class Port(Protocol):
    """Where a client meets an emulated device."""

    path: str

    def service(self, now: float) -> None:
        """Let bytes pass in both directions up to ``now`` [s]."""
        ...


class Pace:
    """How far the world is behind the wall: up to ``LAG``, which it catches up with.

    What a computer is slower than that is lost: the world then runs slowly, each byte still in its
    time of the world.

    Attributes:
        lost: Time of the wall that the world has missed [s].
    """

    def __init__(self, now: float, wall: float) -> None:
        self.lost = 0.0
        self._told = 0.0
        self._ahead = now - wall

    def behind(self, now: float, wall: float) -> float:
        """Return by how much the world, at ``now``, is behind the ``wall`` [s]; below 0: ahead."""
        behind = wall + self._ahead - now
        if behind > LAG:
            self.lost += behind - LAG
            self._ahead -= behind - LAG
            behind = LAG
        if self.lost - self._told >= LOST:
            self._told = self.lost
            log.warning(
                "this computer is too busy: the emulated world has lost %.1f s so far; clients may "
                "find the devices slow or silent; end other programs",
                self.lost,
            )
        return behind


def serve(ports: Sequence[Port], clock: Clock, ended: Callable[[], bool] = lambda: False) -> None:
    """Serve ``ports`` while ``clock`` keeps pace with the time on the wall, until ``ended``."""
    pace = Pace(clock.now(), time.monotonic())
    while not ended():
        behind = pace.behind(clock.now(), time.monotonic())
        if behind > 0:
            # A hazard is the emulated base's to tell, in bytes.
            with suppress(HazardError):
                clock.sleep(min(behind, SLICE))
        else:
            time.sleep(-behind)
        for port in ports:
            port.service(clock.now())
