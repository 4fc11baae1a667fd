"""A watchdog for a base that has none: a guard stops the wheels if this process cannot.

Without one, such a base keeps executing its last drive command. The guard is a separate process
that also holds the port and reads heartbeats from a pipe. The drive loop itself writes them while
the wheels turn, not a thread, which might outlive the loop. If no heartbeat arrives for 0.3 s (the
loop hangs) or the pipe ends (the process was killed), the guard sends the base its farewell.
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
"""Time without a heartbeat after which a driving process is taken to hang [s]."""
INTERVAL = 0.05
"""Time between two heartbeats [s]."""


class Guard(Protocol):
    """Stops the wheels if this process cannot."""

    def beat(self, moving: bool) -> None:
        """Send a heartbeat that says whether the base is driving."""
        ...


class NoGuard:
    """No guard, for virtual time or a base with a watchdog of its own."""

    def beat(self, moving: bool) -> None:
        """See ``Guard.beat``."""


class ProcessGuard:
    """A ``Guard`` in a separate process, which Ctrl-C in the terminal does not reach."""

    def __init__(self, port: int, farewell: bytes, clock: Clock) -> None:
        """Start the process.

        Args:
            port: File descriptor of the base's open port.
            farewell: Bytes that stop the wheels and leave the base at rest, whatever was sent
                before.
            clock: Limits heartbeats to one per ``INTERVAL``.
        """
        self._clock = clock
        self._moving = False
        self._due = -math.inf

        # Start the process at the end of a pipe
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
            HazardError: The guard process has ended, so the robot must not drive.
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
        """End the guard process; the wheels must have been stopped."""
        with suppress(BrokenPipeError):
            os.write(self._pipe, guard_process.GOODBYE)
        os.close(self._pipe)
        self._process.wait(timeout=5.0)


class PortGuard:
    """A ``Guard`` for a port that may be unplugged: a new process each time the port is opened.

    A process that still held the unplugged port would prevent its name from being used again. If
    ``farewell`` is empty there is no process: the base has a watchdog of its own.
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
        """See ``Guard.beat``; does nothing while no port is guarded."""
        if self._guard is not None:
            self._guard.beat(moving)

    def close(self) -> None:
        """End the process; closing twice does nothing."""
        guard, self._guard = self._guard, None
        if guard is not None:
            guard.close()
