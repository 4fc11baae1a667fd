"""What base, lidar and turntable report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from scan3d_twin.core.types.arrays import FloatArray, IntArray
from scan3d_twin.core.types.pose import Pose2

VALID = -1
"""Entry of a ``codes`` array where the reading is a distance, not an error code."""
MIXED = -2
"""Entry of a ``codes`` array where the reading was removed as a mixed pixel."""
UNMEASURED = -3
"""Entry of a ``codes`` array where the line had no beam, or its reading is unknown."""
LOST = -4
"""Entry of a ``codes`` array of a scan line where the reading was lost on its way from the sensor:
another pass may still get it. In a range image it is ``UNMEASURED``."""


@dataclass(frozen=True, slots=True)
class LidarSpec:
    """Geometry and timing of a scan line.

    A line may have elevations and times of its own, beam j near those stated here.

    Attributes:
        elevations: Beam angle in the vertical scan plane (n_beams,) [rad]; 0 ahead, positive up.
        beam_times: Time of each beam after the line's stamp (n_beams,) [s].
        line_period: Time between two lines, nominally [s].
        min_range: Shortest distance that the lidar reports [m].
        max_range: Longest distance that is trusted [m].
    """

    elevations: FloatArray
    beam_times: FloatArray
    line_period: float
    min_range: float
    max_range: float

    @property
    def n_beams(self) -> int:
        """Number of beams in a line."""
        return len(self.elevations)


@dataclass(frozen=True, slots=True)
class ScanLine:
    """One revolution of the lidar.

    Attributes:
        stamp: Time of step 0 of the revolution on ``Clock.now()`` [s].
        ranges: Distances (n_beams,) [m]; NaN where there is no valid return.
        codes: The sensor's error codes (n_beams,); ``VALID`` where ``ranges`` is a distance.
        elevations: Beam angles of this line (n_beams,) [rad]; None if they are those of the
            ``LidarSpec``. ``arrange_line`` makes lines of beams at any angles.
        beam_times: Times of its beams after the stamp (n_beams,) [s]; None as for ``elevations``.
    """

    stamp: float
    ranges: FloatArray
    codes: IntArray
    elevations: FloatArray | None = None
    beam_times: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class Beams:
    """Readings one after another, as a lidar that turns all round takes them.

    Attributes:
        times: When each was measured, on ``Clock.now()``, ascending (n,) [s].
        elevations: Beam angles, as in ``LidarSpec``, in [-pi, pi) (n,) [rad].
        ranges: Distances (n,) [m]; NaN where there is no valid return.
        codes: Error codes (n,), ``VALID`` where ``ranges`` is a distance.
    """

    times: FloatArray
    elevations: FloatArray
    ranges: FloatArray
    codes: IntArray

    def __len__(self) -> int:
        return len(self.times)

    def select(self, which: Any) -> Beams:
        """Return the beams at an index, a slice or a mask, in their order."""
        return Beams(
            self.times[which], self.elevations[which], self.ranges[which], self.codes[which]
        )

    @staticmethod
    def join(parts: Sequence[Beams]) -> Beams:
        """Return ``parts`` one after another; no beams if there are none."""
        if not parts:
            return Beams(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int64))
        return Beams(
            np.concatenate([part.times for part in parts]),
            np.concatenate([part.elevations for part in parts]),
            np.concatenate([part.ranges for part in parts]),
            np.concatenate([part.codes for part in parts]),
        )


@dataclass(frozen=True, slots=True)
class Odometry:
    """Pose of the base by dead reckoning.

    Attributes:
        stamp: Time on ``Clock.now()`` [s].
        T_odom_base: Pose in the frame in which the robot was opened.
        covariance: Covariance of x, y [m] and yaw [rad] since opening (3, 3).
    """

    stamp: float
    T_odom_base: Pose2
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class TableAngle:
    """Angle of a turntable by its own sensor.

    Attributes:
        stamp: Time on ``Clock.now()`` [s].
        angle: About the turning axis, 0 in the middle [rad]. The play of its gear stands between
            it and the angle of what it carries.
    """

    stamp: float
    angle: float


@dataclass(frozen=True, slots=True)
class Hazards:
    """The conditions that stop the robot; all False with a charged battery is safe.

    Attributes:
        battery: State of charge, 0..1.
    """

    bump_left: bool = False
    bump_right: bool = False
    cliff_left: bool = False
    cliff_front_left: bool = False
    cliff_front_right: bool = False
    cliff_right: bool = False
    wheel_drop_left: bool = False
    wheel_drop_right: bool = False
    overcurrent_left: bool = False
    overcurrent_right: bool = False
    battery: float = 1.0

    def active(self) -> tuple[str, ...]:
        """Return the active hazards in words."""
        flags = _read_flags(self)
        if True not in flags:  # nearly always
            return ()
        named = zip(_FLAGS, flags, strict=True)
        return tuple(name.replace("_", " ") for name, is_set in named if is_set)


_FLAGS = tuple(name for name in Hazards.__slots__ if name != "battery")
_read_flags = attrgetter(*_FLAGS)
