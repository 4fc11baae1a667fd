"""Test helper: a virtual clock, and a lidar with known readings instead of a scene."""

import numpy as np

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.types import VALID, LidarSpec, ScanLine, read_only
from scan3d_twin.devices.urg import model as urg04lx

STEPS = range(urg04lx.FIRST_STEP, urg04lx.LAST_STEP + 1)
PHASE = 0.037


class VirtualClock:
    """A ``Clock`` that advances only by ``sleep``."""

    def __init__(self):
        self.time = 0.0

    def now(self):
        """See ``Clock.now``."""
        return self.time

    def sleep(self, seconds):
        """See ``Clock.sleep``."""
        self.time += max(0.0, seconds)


class KnownLidar:
    """A ``Lidar`` whose readings [mm] are a function of the turn's number."""

    def __init__(self, clock):
        self.clock = clock
        self.next = 0
        self.spec = LidarSpec(
            elevations=read_only([urg04lx.step_angle(step) for step in STEPS]),
            beam_times=read_only([urg04lx.step_time(step) for step in STEPS]),
            line_period=urg04lx.REVOLUTION,
            min_range=urg04lx.MIN_RANGE_MM / 1000,
            max_range=urg04lx.MAX_RANGE_MM / 1000,
        )

    @staticmethod
    def stamp(turn):
        """Return the time of step 0 of a ``turn`` [s]."""
        return PHASE + turn * urg04lx.REVOLUTION

    @staticmethod
    def turn_at(stamp):
        """Return the number of the turn at ``stamp`` [s]."""
        return round((stamp - PHASE) / urg04lx.REVOLUTION)

    @staticmethod
    def values(turn):
        """Return the readings of a ``turn`` as the sensor sends them [mm, codes]."""
        rng = np.random.default_rng(turn)
        values = rng.integers(urg04lx.MIN_RANGE_MM, urg04lx.MAX_RANGE_MM + 1, len(STEPS))
        return np.where(rng.random(len(STEPS)) < 0.15, rng.integers(0, 20, len(STEPS)), values)

    def read_line(self, timeout):
        """See ``Lidar.read_line``."""
        last = int((self.clock.now() + 1e-9 - PHASE - urg04lx.REPLY_LATENCY) / urg04lx.REVOLUTION)
        self.next = max(self.next, last - 15)
        if self.clock.now() < self.stamp(self.next) + urg04lx.REPLY_LATENCY - 1e-9:
            raise LinkTimeoutError("no line yet")
        self.next += 1
        return line_of(self.stamp(self.next - 1), self.values(self.next - 1))


def line_of(stamp, values):
    """Return a scan line of readings as the sensor sends them [mm, codes]."""
    valid = values >= urg04lx.MIN_RANGE_MM
    ranges = read_only(np.where(valid, values / 1000, np.nan))
    return ScanLine(stamp, ranges, read_only(np.where(valid, VALID, values), np.int64))


def values_of(line):
    """Return the readings of a line as the sensor sent them [mm]."""
    return np.where(line.codes == VALID, np.round(np.nan_to_num(line.ranges) * 1000), line.codes)
