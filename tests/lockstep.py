"""Test helper: the wired robot cut in two: the twin in this process, the drivers in another.

So that the process with the drivers has only what `twin real` imports, and time stays virtual: it
passes here, and there is a call for whatever the drivers ask of it.

    python tests/lockstep.py CONNECTION_FD OUT [LINE_OF_TOML ...]
"""

import socket
import subprocess
import sys
import tomllib
from contextlib import closing, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

from scan3d_twin.cli.commands.real import SMALL_COMPUTER
from scan3d_twin.cli.memory import give_back_memory
from scan3d_twin.cli.run import run
from scan3d_twin.core.config import preset_options
from scan3d_twin.devices import reconnecting
from scan3d_twin.devices.create import codec as oi
from scan3d_twin.devices.links.transport import Tapped
from scan3d_twin.real import robot
from scan3d_twin.recording.recorder import SerialTaps
from scan3d_twin.run.folder import claim_folder
from scan3d_twin.run.settings import REAL_SCENE, build_settings

LINES = ("base", "lidar")


@contextmanager
def far_drivers(wires, clock, out, options):
    """Digitise with drivers in a process of their own; yield how it ended when it has."""
    here, there = socket.socketpair()
    with there:
        command = [sys.executable, __file__, str(there.fileno()), str(out), *options]
        process = subprocess.Popen(
            command,
            pass_fds=[there.fileno()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
    try:
        with closing(Connection(here.detach())) as connection:
            serve(connection, wires, clock)
        output, errors = process.communicate(timeout=60)
        yield subprocess.CompletedProcess(command, process.returncode, output, errors)
    finally:
        process.kill()
        process.wait()


def serve(connection, wires, clock):
    """Answer calls until the other process hangs up; each answer says what time it is."""
    while True:
        try:
            line, name, *values = connection.recv()
        except EOFError:
            return
        target = clock if line == "clock" else wires[line]
        result = getattr(target, name)(*values)
        arrived = {}
        if name == "sleep":
            arrived = {each: wire.read(0.0) for each, wire in wires.items()}
        connection.send((result, clock.now(), arrived))


class FarClock:
    """The clock in the other process."""

    def __init__(self, connection):
        self.arrived = {line: bytearray() for line in LINES}
        self._connection = connection
        self._now = 0.0
        self.call("clock", "now")

    def now(self):
        """See ``Clock.now``."""
        return self._now

    def sleep(self, seconds):
        """See ``Clock.sleep``."""
        self.call("clock", "sleep", seconds)

    def call(self, line, name, *values):
        """Call a method in the other process and return its result."""
        self._connection.send((line, name, *values))
        result, self._now, arrived = self._connection.recv()
        for each, data in arrived.items():
            self.arrived[each] += data
        return result


class FarLine:
    """A transport whose other end is in the other process."""

    def __init__(self, line, clock):
        self._line, self._clock = line, clock

    def read(self, timeout):
        """See ``Transport.read``."""
        arrived = self._clock.arrived[self._line]
        if arrived or timeout <= 0.0:
            data = bytes(arrived)
            arrived.clear()
            return data
        return self._clock.call(self._line, "read", timeout)

    def write(self, data):
        """See ``Transport.write``."""
        self._clock.call(self._line, "write", data)

    def set_baud(self, baud):
        """See ``Transport.set_baud``."""
        self._clock.call(self._line, "set_baud", baud)

    def set_dtr(self, on):
        """See ``Transport.set_dtr``."""
        self._clock.call(self._line, "set_dtr", on)

    def discard_input(self):
        """See ``Transport.discard_input``."""
        self._clock.arrived[self._line].clear()
        self._clock.call(self._line, "discard_input")

    def close(self):
        """See ``Transport.close``."""
        self.discard_input()


def main():
    """Digitise with the drivers here, as `twin real` does, and print its report."""
    give_back_memory()
    # Each step of the time is two switches of process: make them as long as the base's period
    robot.SLICE = reconnecting.POLL = oi.PERIOD
    clock, taps = FarClock(Connection(int(sys.argv[1]))), SerialTaps()
    given = tomllib.loads("\n".join(sys.argv[3:]))
    effective = build_settings(
        [preset_options("best"), SMALL_COMPUTER, given, {"run": {"scene": REAL_SCENE}}]
    )
    folder = claim_folder(Path(sys.argv[2]))
    run(effective, REAL_SCENE, opening(clock, taps), folder, as_json=True, taps=taps)
    print(sorted({name.partition(".")[0] for name in sys.modules}), file=sys.stderr)


@contextmanager
def opening(clock, taps):
    """Open the robot of the real drivers over the other process."""
    base = Tapped(FarLine("base", clock), clock, taps.base)

    def open_lidar():
        """Return the lidar's serial line, tapped."""
        return Tapped(FarLine("lidar", clock), clock, taps.lidar)

    with robot.open_over(base, open_lidar, clock) as opened:
        yield opened, None


if __name__ == "__main__":
    main()
