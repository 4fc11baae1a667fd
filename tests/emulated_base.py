"""Test helper: an emulated base on a pseudo-terminal for other processes to drive."""

import time

from kinematic import JumpingClock, KinematicBase

from scan3d_twin.devices.create.codec import CREATE2
from scan3d_twin.devices.create.emulator import CreateEmulator
from scan3d_twin.devices.links.line_model import Line
from scan3d_twin.devices.links.pty import PtyPort
from scan3d_twin.devices.links.serve import serve


class Road:
    """An emulated base on a pseudo-terminal, in real time."""

    def __init__(self, model=CREATE2):
        self.base = KinematicBase()
        self.device = CreateEmulator(self.base, model)
        self._clock = JumpingClock(self.base)
        self.port = PtyPort(Line(self.device))
        self.close = self.port.close

    def serve(self, until, timeout=20.0):
        """Serve the port until something holds; return how long that took."""
        started = time.monotonic()

        def ended():
            """Return whether it holds; fail after the timeout."""
            assert time.monotonic() - started < timeout
            return until()

        serve([self.port], self._clock, ended)
        return time.monotonic() - started
