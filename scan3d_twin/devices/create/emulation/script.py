"""The script of an emulated Create: commands 152 to 158 of the Open Interface, pages 15 and 16."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.create.codec import Command, CommandParser, Model
from scan3d_twin.devices.create.emulation.body import Body
from scan3d_twin.devices.create.emulation.script_events import has_happened
from scan3d_twin.devices.create.packets import Mode


class Script:
    """The stored script, the commands of it that are left to play, and what is waited for.

    Attributes:
        stored: The commands that are stored, as bytes.
    """

    def __init__(self, model: Model, body: Body) -> None:
        self.stored = b""
        self._model, self._body = model, body
        self._queue: deque[Command] = deque()
        self._wait: Callable[[float, Mode], bool] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a script plays or a command waits."""
        return self._wait is not None or bool(self._queue)

    def store(self, command: Command) -> None:
        """Store the script of ``command``, unless it is too long."""
        if command.data[0] <= oi.MAX_SCRIPT:
            self.stored = command.data[1:]

    def play(self) -> None:
        """Play the stored script, after what is left of another one."""
        self._queue.extend(CommandParser(self._model).feed(self.stored))

    def next_command(self, now: float, mode: Mode) -> Command | None:
        """Return the next command at ``now`` [s]; None while the script waits, or at its end."""
        if self._wait is not None:
            if not self._wait(now, mode):
                return None
            self._wait = None
        return self._queue.popleft() if self._queue else None

    def wait_time(self, command: Command, now: float) -> None:
        """Wait for a time from ``now`` [s] on."""
        until = now + command.data[0] / 10
        self._wait = lambda now, _: now >= until

    def wait_distance(self, command: Command) -> None:
        """Wait until the base has gone a distance; resets packet 19."""
        (way,), wheels = command.words(), self._body.wheels
        wheels.distance_mm, goal = 0.0, wheels.total_mm + way
        sign = 1 if way >= 0 else -1
        self._wait = lambda *_: sign * (wheels.total_mm - goal) >= 0

    def wait_angle(self, command: Command) -> None:
        """Wait until the base has turned by an angle; resets packet 20."""
        (turn,), wheels = command.words(), self._body.wheels
        wheels.angle_deg, goal = 0.0, wheels.total_deg + turn
        sign = 1 if turn >= 0 else -1
        self._wait = lambda *_: sign * (wheels.total_deg - goal) >= 0

    def wait_event(self, command: Command) -> None:
        """Wait until an event happens."""
        event = int.from_bytes(command.data, "big", signed=True)
        self._wait = lambda _, mode: has_happened(event, self._body, mode)
