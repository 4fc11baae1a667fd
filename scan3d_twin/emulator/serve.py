"""Serving emulated devices in real time: the only place in ``emulator`` that knows the time."""

from __future__ import annotations

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


class Port(Protocol):
    """Where a client meets an emulated device."""

    path: str

    def service(self, now: float) -> None:
        """Let bytes pass in both directions up to ``now`` [s]."""
        ...


def serve(ports: Sequence[Port], clock: Clock, ended: Callable[[], bool] = lambda: False) -> None:
    """Serve ``ports`` while ``clock`` keeps pace with the time on the wall, until ``ended``."""
    ahead = clock.now() - time.monotonic()
    while not ended():
        behind = time.monotonic() + ahead - clock.now()
        if behind > LAG:
            ahead -= behind - LAG
        if behind > 0:
            # A hazard is the emulated base's to tell, in bytes.
            with suppress(HazardError):
                clock.sleep(min(behind, SLICE))
        else:
            time.sleep(-behind)
        for port in ports:
            port.service(clock.now())
