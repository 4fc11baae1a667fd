"""What a bad line does to the packets of the LDROBOT lidars: how many wrong readings get through.

An emulated lidar sends known distances over a line that loses, inserts and flips bytes. Printed are
the damaged packets that the CRC-8 misses (theory: 1 in 256), those of them that the driver then
finds implausible, and the wrong readings among those that reach a scan line.

    python benchmarks/ld_corruption.py --lidar ld19 --seconds 300 --corrupt 0.001
"""

from __future__ import annotations

import argparse
import math
from collections import deque

import numpy as np

from scan3d_twin.core.hal import Clock
from scan3d_twin.core.types import UNMEASURED, VALID, Beams, FloatArray, LidarSpec, ScanLine
from scan3d_twin.devices.ldrobot.codec import Packet, Splitter
from scan3d_twin.devices.ldrobot.driver import LdLidar
from scan3d_twin.devices.ldrobot.emulator import LdEmulator
from scan3d_twin.devices.ldrobot.model import MODELS, TURN_RATE, LdModel
from scan3d_twin.devices.links.line_model import Faults, Line, Wire
from scan3d_twin.devices.rotating import to_elevation

WRONG = 0.005
"""Error from which on a reading is wrong [m]; whole millimetres and hundredths of degrees make
less."""


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


def true_range(elevations: FloatArray) -> FloatArray:
    """Return the distances [m] at ``elevations`` [rad]."""
    return np.asarray(np.rint(2000 + 300 * np.cos(elevations - 0.5)) / 1000)


class KnownScene:
    """A ``BeamStream`` with known distances."""

    def __init__(self, clock: Clock, model: LdModel) -> None:
        self.spec: LidarSpec = model.spec
        self._clock, self._rate, self._count = clock, model.sample_rate, 0

    def read_line(self, timeout: float) -> ScanLine:
        """See ``Lidar.read_line``: there are none, as the emulator reads beams."""
        raise NotImplementedError

    def read_beams(self) -> Beams:
        """See ``BeamStream.read_beams``."""
        last = math.floor(self._clock.now() * self._rate)
        numbers = np.arange(self._count, last)
        self._count = last
        times = numbers / self._rate
        elevations = to_elevation(math.tau * TURN_RATE * times - math.pi)
        return Beams(times, elevations, true_range(elevations), np.full(len(times), VALID))


class SentPackets(LdEmulator):
    """An emulator that remembers what it has sent of late."""

    def __init__(self, clock: Clock, model: LdModel) -> None:
        super().__init__(KnownScene(clock, model), model)
        self.recent: deque[Packet] = deque(maxlen=400)
        self.sent = 0

    def _pack(self, beams: Beams) -> Packet:
        packet = super()._pack(beams)
        self.recent.append(packet)
        self.sent += 1
        return packet


class CountingSplitter(Splitter):
    """A splitter that counts packets that were never sent."""

    def __init__(self, emulator: SentPackets) -> None:
        super().__init__()
        self._emulator = emulator
        self.good = self.missed = 0

    def feed(self, data: bytes) -> list[Packet]:
        """See ``Splitter.feed``."""
        packets = super().feed(data)
        known = set(self._emulator.recent)
        self.good += sum(packet in known for packet in packets)
        self.missed += sum(packet not in known for packet in packets)
        return packets


class TappedWire(Wire):
    """A wire whose bytes are counted before the driver sees them."""

    def __init__(self, line: Line, clock: Clock, splitter: CountingSplitter) -> None:
        super().__init__(line, clock)
        self._splitter = splitter

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``."""
        data = super().read(timeout)
        self._splitter.feed(data)
        return data


def main() -> None:
    """Print the counts of one run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    models = {model.name.lower(): model for model in MODELS}
    parser.add_argument("--lidar", choices=models, default="ld19")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--corrupt", type=float, default=0.001)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    # Listen to a bad line
    clock, p, model = VirtualClock(), options.corrupt, models[options.lidar]
    emulator = SentPackets(clock, model)
    line = Line(emulator, Faults(drop=p, insert=p, flip=p), options.seed)
    splitter = CountingSplitter(emulator)
    lidar = LdLidar(lambda: TappedWire(line, clock, splitter), clock, model)
    wrong = readings = lines = 0
    while clock.now() < options.seconds:
        each = lidar.read_line(1.0)
        assert each.elevations is not None
        valid = np.flatnonzero(each.codes == VALID)
        off = np.abs(each.ranges[valid] - true_range(each.elevations[valid]))
        lost = np.count_nonzero((each.codes != VALID) & (each.codes != UNMEASURED))
        wrong += np.count_nonzero(off > WRONG) + lost
        readings, lines = readings + len(valid), lines + 1

    # Print what became of its packets
    sent = emulator.sent
    damaged = sent - splitter.good
    print(f"{lines} lines, {sent} packets sent, {damaged} damaged ({damaged / sent:.1%})")
    print(
        f"missed by the CRC-8: {splitter.missed}, 1 in {damaged / max(1, splitter.missed):.0f} of "
        f"those damaged; rejected as implausible: {lidar.bad - splitter.bad}"
    )
    print(f"wrong readings: {wrong} of {readings}, {1e5 * wrong / readings:.2f} in 100000")


if __name__ == "__main__":
    main()
