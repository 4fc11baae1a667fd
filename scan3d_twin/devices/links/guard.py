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
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.links import guard_process

SILENCE = 0.3
"""Time without a heartbeat after which a driving process is taken to hang [s]."""
INTERVAL = 0.05
"""Time between two heartbeats [s]."""
MAX_SUSPENSION = 1.0
"""Time for which a driving process may be suspended (Ctrl-Z, SIGSTOP) and drive on when continued
[s]: after that, people do not expect the robot to move; assumption."""


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

    It also notices that this process was suspended while the base drove.
    """

    def __init__(
        self, farewell: bytes, clock: Clock, continuations: Callable[[], int] = lambda: 0
    ) -> None:
        """Guard nothing yet.

        Args:
            farewell: See ``ProcessGuard``.
            clock: Limits heartbeats, and times suspensions.
            continuations: Returns how often this process was continued after a suspension.
        """
        self._farewell, self._clock = farewell, clock
        self._guard: ProcessGuard | None = None
        self._continuations, self._continued = continuations, continuations()
        self._moving, self._beaten = False, clock.now()
        self._suspended = 0.0

    def watch(self, port: int) -> None:
        """Guard the open ``port`` (file descriptor) from now on."""
        self.close()
        if self._farewell:
            self._guard = ProcessGuard(port, self._farewell, self._clock)

    def beat(self, moving: bool) -> None:
        """See ``Guard.beat``; sends nothing while no port is guarded.

        Raises:
            HazardError: The guard process has ended, or this process was suspended for more than
                ``MAX_SUSPENSION`` while the base drove: stop it before it drives again.
        """
        if self._guard is not None:
            self._guard.beat(moving)
        self._notice_suspension(moving)
        if self._suspended:
            raise HazardError(
                f"stopped: this program was suspended for {self._suspended:.1f} s while the robot "
                "drove (the guard stopped it meanwhile), and does not drive on by itself"
            )

    def _notice_suspension(self, moving: bool) -> None:
        """Keep the length of a long suspension until the base stands."""
        # What happened since the last heartbeat
        now, continued = self._clock.now(), self._continuations()
        away = now - self._beaten
        was_suspended = continued != self._continued and away > MAX_SUSPENSION

        # Keep it
        if not moving:
            self._suspended = 0.0
        elif self._moving and was_suspended:
            self._suspended = away
        self._moving, self._beaten, self._continued = moving, now, continued

    def close(self) -> None:
        """End the process; closing twice does nothing."""
        guard, self._guard = self._guard, None
        if guard is not None:
            guard.close()
