"""What a bad line does to the frames of an RPLIDAR: how many wrong readings get through.

An emulated lidar in a room with a box sends known distances over a line that loses, inserts and
flips bytes. Printed are the frames that were damaged, those of them that passed their check, those
intact that were lost with them, and the wrong readings among those that reach a scan line.

    python benchmarks/rplidar_corruption.py --lidar rplidar_c1 --link dense --seconds 100
"""

from __future__ import annotations

import argparse
import math
from collections import deque

import numpy as np

from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import VALID, Beams, FloatArray, IntArray, ScanLine
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.rotating import to_elevation
from scan3d_twin.devices.rplidar.codec import ReplyType
from scan3d_twin.devices.rplidar.driver import RplidarLidar, line_spec
from scan3d_twin.devices.rplidar.emulator import RplidarEmulator, Sample
from scan3d_twin.devices.rplidar.frames import CapsuleSplitter, NodeSplitter
from scan3d_twin.devices.rplidar.model import MODELS, RplidarModel, ScanMode

BOUNDS_MM = (0.5, 5.0, 30.0)
"""Errors from which on a reading is wrong [mm]: any, as for the LDROBOT lidars, and three standard
deviations of the noise of a C1."""
RECENT = 4000
"""Frames sent of late that are remembered."""


class VirtualClock:
    """A ``Clock`` that advances only by ``sleep``."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        self._now += max(0.0, seconds)


class Room:
    """A ``BeamStream`` in the middle of a room of 2.4 by 4 m, with a box at 0.7 m."""

    def __init__(self, clock: Clock, model: RplidarModel, mode: ScanMode) -> None:
        self.spec = line_spec(model, mode)
        self._clock, self._count = clock, 0
        self._rate, self._speed = mode.sample_rate, math.tau * model.turns

    def ranges(self, samples: IntArray) -> FloatArray:
        """Return the distances of ``samples`` by their number, in whole millimetres [m]."""
        angles = self._speed / self._rate * samples % math.tau
        with np.errstate(divide="ignore"):
            walls = np.minimum(1.2 / np.abs(np.sin(angles)), 2.0 / np.abs(np.cos(angles)))
        return np.asarray(np.rint(1000 * np.where(np.abs(angles - 0.5) < 0.13, 0.7, walls)) / 1000)

    def samples(self, line: ScanLine, at: IntArray) -> IntArray:
        """Return the numbers of the readings ``at`` some places: by angle, the turn by time."""
        assert line.elevations is not None
        assert line.beam_times is not None
        expected = self._speed * (line.stamp + line.beam_times[at])
        angles = expected + to_elevation(line.elevations[at] - expected)
        return np.asarray(np.rint(angles * self._rate / self._speed).astype(np.int64))

    def read_beams(self) -> Beams:
        """See ``BeamStream.read_beams``."""
        last = math.floor(self._clock.now() * self._rate)
        numbers, self._count = np.arange(self._count, last), last
        elevations = to_elevation(self._speed / self._rate * numbers)
        codes = np.full(len(numbers), VALID)
        return Beams(numbers / self._rate, elevations, self.ranges(numbers), codes)

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``: there are none, as the emulator reads beams."""
        raise NotImplementedError


class CountingEmulator(RplidarEmulator):
    """An emulator that remembers what it has sent of late."""

    def __init__(self, room: Room, model: RplidarModel) -> None:
        super().__init__(room, model)
        self.recent: deque[bytes] = deque(maxlen=RECENT)
        self.sent = 0

    def _encode(self, mode: ScanMode, chunk: list[Sample]) -> bytes:
        frame = super()._encode(mode, chunk)
        self.recent.append(frame)
        self.sent += 1
        return frame


class CountingWire(Wire):
    """A wire that counts the frames that pass their check: sent ones, and others."""

    def __init__(
        self, line: Line, clock: Clock, emulator: CountingEmulator, mode: ScanMode
    ) -> None:
        super().__init__(line, clock)
        self._emulator, self._clock_of_wire = emulator, clock
        self._splitter = NodeSplitter() if mode.reply is ReplyType.NODES else CapsuleSplitter()
        self.good = self.missed = 0

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``."""
        data = super().read(timeout)
        frames = self._splitter.feed(data, self._clock_of_wire.now()) if data else []
        known = set(self._emulator.recent) if frames else set()
        self.good += sum(frame.data in known for frame in frames)
        self.missed += sum(frame.data not in known for frame in frames)
        return data


def main() -> None:
    """Print the counts of one run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    models = {model.name: model for model in MODELS.values()}
    parser.add_argument("--lidar", choices=models, default="rplidar_c1")
    parser.add_argument("--link", default="")
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--corrupt", type=float, default=0.001)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    # Listen to a bad line
    clock, p, model = VirtualClock(), options.corrupt, models[options.lidar]
    mode = model.modes[options.link or next(iter(model.modes))]
    room = Room(clock, model, mode)
    emulator = CountingEmulator(room, model)
    line = Line(emulator, Faults(drop=p, insert=p, flip=p), options.seed)
    wires: list[CountingWire] = []

    def open_wire() -> CountingWire:
        wires.append(CountingWire(line, clock, emulator, mode))
        return wires[-1]

    lidar = RplidarLidar(open_wire, clock, model, (mode,))
    off: list[float] = []
    readings = 0
    while clock.now() < options.seconds:
        each = lidar.read_line(2.0)
        at = np.flatnonzero(each.codes == VALID)
        errors = 1000 * np.abs(each.ranges[at] - room.ranges(room.samples(each, at)))
        off += errors[errors > min(BOUNDS_MM)].tolist()
        readings += len(at)

    # Print what became of its frames
    missed, good = sum(w.missed for w in wires), sum(w.good for w in wires)
    lost = emulator.sent - good
    print(
        f"{model.name}, {mode.name}: {emulator.sent} frames sent, {lost} damaged or lost with "
        f"those ({lost / emulator.sent:.2%}); {missed} damaged ones passed the check "
        f"({missed / emulator.sent:.1e} of all)"
    )
    for bound in BOUNDS_MM:
        wrong = sum(each > bound for each in off)
        print(
            f"  readings more than {bound:g} mm wrong: {wrong} of {readings}, "
            f"{1e5 * wrong / readings:.2f} in 100000"
        )


if __name__ == "__main__":
    main()
