"""Test helper: a lidar that turns all round in a room with known walls, instead of a scene."""

import math

import numpy as np

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.types import VALID, Beams
from scan3d_twin.devices.rotating import to_elevation
from scan3d_twin.devices.rplidar.driver import line_spec

HALF_WIDTH, HALF_DEPTH = 1.2, 2.0
"""Of the room, with the lidar in its middle [m]."""
BOX = (math.radians(20.0), math.radians(35.0), 0.7)
"""First and last angle of a box, and its distance [m]."""


def room(angles):
    """Return the distances in whole millimetres at ``angles`` (n,) [rad]."""
    walls = np.minimum(
        HALF_WIDTH / np.maximum(np.abs(np.sin(angles)), 1e-9),
        HALF_DEPTH / np.maximum(np.abs(np.cos(angles)), 1e-9),
    )
    first, last, distance = BOX
    inside = (angles % math.tau >= first) & (angles % math.tau <= last)
    return np.round(np.where(inside, distance, walls) * 1000)


class TurningLidar:
    """A ``BeamStream`` in the room: its beams lie elsewhere in each turn.

    Args:
        clock: Virtual clock.
        model: The kind of RPLIDAR.
        mode: How it scans.
        speed: Turns per second, as a share of the nominal.
        skew: By how much its samples take longer than stated.
        distances: Returns the distances [mm] at angles [rad].
    """

    def __init__(self, clock, model, mode, speed=1.0, skew=0.0, distances=room):
        self._distances = distances
        self.clock = clock
        self.spec = line_spec(model, mode)
        self._period = mode.sample_us * 1e-6 * (1 + skew)
        self._turn = math.tau * model.turns * speed
        self._next = 0

    def angle_at(self, times):
        """Return the angles at ``times`` [s], clockwise from ahead [rad]."""
        return 0.4 + self._turn * np.asarray(times)

    def truth(self, line, at):
        """Return the distances [mm] that were measured where ``line`` has readings ``at``.

        Which sample each was is told by its angle; its time tells the turn.
        """
        times, angles = line.stamp + line.beam_times[at], line.elevations[at]
        expected = self.angle_at(times)
        whole = expected + to_elevation(angles - expected)
        samples = np.rint((whole - self.angle_at(0.0)) / (self._turn * self._period))
        return np.round(self._distances(self.angle_at(samples * self._period) % math.tau))

    def read_beams(self):
        """See ``BeamStream.read_beams``."""
        first = self._next
        self._next = max(first, 1 + math.floor(self.clock.now() / self._period + 1e-9))
        times = self._period * np.arange(first, self._next)
        angles = self.angle_at(times)
        codes = np.full(len(times), VALID)
        return Beams(
            times, to_elevation(angles), np.round(self._distances(angles % math.tau)) / 1000, codes
        )

    def read_line(self, timeout):
        """See ``Lidar.read_line``; not used by emulators of such lidars."""
        raise LinkTimeoutError("no line")
