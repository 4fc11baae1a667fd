"""A base that obeys its last drive command for ever: a guard stops it if this process cannot.

Such a base has no watchdog. A process of its own holds the port too, and listens to signs
of life that the drive loop itself writes while the wheels turn, not a thread that would outlive it.
No sign for 0.3 s (the loop hangs), or the end of the pipe (the process was killed), and the guard
sends the base its farewell.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from contextlib import suppress
from typing import Protocol

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links import guard_process

SILENCE = 0.3
"""Without a sign of life for so long the driving process hangs [s]."""
INTERVAL = 0.05
"""Between two signs of life [s]."""


class Guard(Protocol):
    """Stops the wheels if this process no longer can."""

    def beat(self, moving: bool) -> None:
        """Report that the process is alive, and whether it drives."""
        ...


class NoGuard:
    """No guard, where time is not real or the base stops by itself."""

    def beat(self, moving: bool) -> None:
        """See ``Guard.beat``."""


class ProcessGuard:
    """A ``Guard`` in a process of its own, which Ctrl-C in the terminal does not reach."""

    def __init__(self, port: int, farewell: bytes, clock: Clock) -> None:
        """Start it.

        Args:
            port: File descriptor of the base's open port.
            farewell: Stops the wheels and leaves the base at rest, whatever was sent before.
            clock: To write a sign of life only every ``INTERVAL``.
        """
        self._clock = clock
        self._moving = False
        self._due = -math.inf
        reader, self._pipe = os.pipe()
        words = [str(port), str(reader), farewell.hex(), str(round(1000 * SILENCE))]
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", guard_process.__file__, *words],
            pass_fds=(port, reader),
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        os.close(reader)

    def beat(self, moving: bool) -> None:
        """See ``Guard.beat``.

        Raises:
            HazardError: The guard itself has ended, so the robot must not drive.
        """
        now = self._clock.now()
        if moving == self._moving and (not moving or now < self._due):
            return
        self._moving, self._due = moving, now + INTERVAL
        try:
            os.write(self._pipe, guard_process.MOVING if moving else guard_process.STANDING)
        except BrokenPipeError:
            if moving:
                raise HazardError("the guard process has ended: driving is not safe") from None

    def close(self) -> None:
        """Send the guard home; the wheels stand."""
        with suppress(BrokenPipeError):
            os.write(self._pipe, guard_process.GOODBYE)
        os.close(self._pipe)
        self._process.wait(timeout=5.0)


class PortGuard:
    """A ``Guard`` of a port that may be unplugged: each time it is opened it gets a new process.

    A process that went on holding an unplugged port would keep its name from coming back. Without
    a ``farewell`` there is no process: the base stops by itself.
    """

    def __init__(self, farewell: bytes, clock: Clock) -> None:
        self._farewell, self._clock = farewell, clock
        self._guard: ProcessGuard | None = None

    def watch(self, port: int) -> None:
        """Guard the open ``port`` (file descriptor) from now on."""
        self.close()
        if self._farewell:
            self._guard = ProcessGuard(port, self._farewell, self._clock)

    def beat(self, moving: bool) -> None:
        """See ``Guard.beat``; without a port there is nobody to tell."""
        if self._guard is not None:
            self._guard.beat(moving)

    def close(self) -> None:
        """Send the process home; closing twice does nothing."""
        guard, self._guard = self._guard, None
        if guard is not None:
            guard.close()
