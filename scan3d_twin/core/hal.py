"""Hardware abstraction layer (HAL): all that the core needs of a robot.

Two implementations exist: the MuJoCo twin (``sim``) and the serial drivers (``real``). Context
managers (``open_sim``, ``open_real``) make them and stop the wheels however they are left; an
object that exists is open. All stamps are on ``Clock.now()``. ``sleep`` and ``read_line`` service
both devices and raise ``HazardError`` within 50 ms of a hazard.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from scan3d_twin.core.types import (
    Beams,
    FloatArray,
    Hazards,
    LidarSpec,
    Odometry,
    ScanLine,
    TableAngle,
)


def default_mount() -> FloatArray:
    """Return ``T_base_lidar``: 0.05 m ahead of the axle, 0.30 m up, step 384 along +x."""
    T = np.eye(4)
    T[0, 3], T[2, 3] = 0.05, 0.30
    T.flags.writeable = False
    return T


class Clock(Protocol):
    """The only source of time for control flow."""

    def now(self) -> float:
        """Return the time [s]; never runs backwards."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let ``seconds`` pass while both devices are serviced.

        Raises:
            HazardError: The base reported a hazard; the wheels are stopped.
        """
        ...


@dataclass(frozen=True, slots=True)
class BaseSpec:
    """Dimensions and limits of a drive base.

    Attributes:
        name: Model, such as ``create2``.
        radius: Radius of the round body [m].
        wheel_base: Distance between the driven wheels [m].
        wheel_diameter: [m].
        counts_per_turn: Encoder counts per wheel turn.
        max_wheel_speed: [m/s].
        sample_period: Time between two sensor packets [s].
        min_wheel_speed: Speed of the faster wheel below which it may not turn at all [m/s].
    """

    name: str
    radius: float
    wheel_base: float
    wheel_diameter: float
    counts_per_turn: float
    max_wheel_speed: float
    sample_period: float
    min_wheel_speed: float = 0.0

    @property
    def is_stand(self) -> bool:
        """Whether it has no wheels that turn."""
        return self.max_wheel_speed == 0.0


class DriveBase(Protocol):
    """A differential-drive base."""

    @property
    def spec(self) -> BaseSpec:
        """The base's model."""
        ...

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        """Drive at ``linear`` [m/s] and ``angular`` [rad/s] until the next command.

        Returns:
            The (linear, angular) that was sent, after clipping to the wheel speed (which keeps the
            ratio) and rounding to the base's resolution.
        """
        ...

    def odometry(self) -> Odometry:
        """Return the latest odometry; its pose was the identity when the robot was opened."""
        ...

    def odometry_since(self, stamp: float) -> tuple[Odometry, ...]:
        """Return the recorded odometry, oldest first, from the last sample before ``stamp`` on."""
        ...

    def hazards(self) -> Hazards:
        """Return the latest hazards; never raises."""
        ...


class Lidar(Protocol):
    """A 2D laser scanner that scans continuously."""

    @property
    def spec(self) -> LidarSpec:
        """Geometry and timing of its lines."""
        ...

    def read_line(self, timeout: float) -> ScanLine:
        """Return the oldest line not yet returned, waiting up to ``timeout`` [s] for it.

        Lines come in order, each once; only the last few unread lines are kept.

        Raises:
            LinkTimeoutError: No line within ``timeout``.
            HazardError: As for ``Clock.sleep``.
        """
        ...


@runtime_checkable
class BunchingLidar(Lidar, Protocol):
    """A lidar that takes less for several lines than for one at a time: the twin's."""

    def read_waiting(self, since: float) -> tuple[ScanLine, ...]:
        """Return the lines that have arrived and were not yet returned, oldest first.

        Those measured before the time ``since`` [s] are left out, and never returned.
        """
        ...


@runtime_checkable
class BeamStream(Lidar, Protocol):
    """A lidar whose readings are there one by one, before its line is complete: the twin's.

    An emulated device sends a reading as soon as it is measured.
    """

    def read_beams(self) -> Beams:
        """Return the beams measured by now and not yet returned, without waiting.

        Only those of the last few revolutions are kept. Lines are read independently of them.
        """
        ...


@dataclass(frozen=True, slots=True)
class TurntableSpec:
    """Limits of a turntable.

    Attributes:
        name: Model, such as ``xl330``.
        min_angle: Smallest angle it turns to [rad].
        max_angle: Largest angle it turns to [rad].
        max_speed: [rad/s].
        resolution: Step of its commands and of its angle sensor [rad].
        sample_period: Time between two samples of its angle [s].
        play: Nominal play between its angle sensor and what it carries [rad].
    """

    name: str
    min_angle: float
    max_angle: float
    max_speed: float
    resolution: float
    sample_period: float
    play: float = 0.0


@runtime_checkable
class Turntable(Protocol):
    """A servo that turns the lidar about one axis, between the base and the lidar."""

    @property
    def spec(self) -> TurntableSpec:
        """The turntable's model."""
        ...

    def turn_to(self, angle: float, speed: float) -> tuple[float, float]:
        """Begin to turn to ``angle`` [rad] at ``speed`` [rad/s], until the next command.

        Returns:
            The (angle, speed) that was sent, after clipping to the limits and rounding to the
            turntable's resolution.

        Raises:
            HazardError: It switched its torque off, as on overload or heat.
        """
        ...

    def stop(self) -> None:
        """Stay at the angle that is reached."""
        ...

    def angle(self) -> TableAngle:
        """Return the latest angle."""
        ...

    def angles_since(self, stamp: float) -> tuple[TableAngle, ...]:
        """Return the recorded angles, oldest first, from the last sample before ``stamp`` on."""
        ...


@dataclass(frozen=True, slots=True)
class Robot:
    """A base that carries a lidar, with the clock that stamps the data of both.

    Attributes:
        base: What carries the lidar; a stand does not drive.
        lidar: It sees the scene.
        clock: Stamps the data of all.
        T_base_lidar: Extrinsics of the lidar (4, 4), with a turntable at its angle 0.
        turntable: What turns the lidar; None where the base does.
        T_base_axis: Pose of the turntable's axis, its z (4, 4); None without a turntable.

    >>> with s3d.open_sim("three_boxes") as (robot, truth):
    ...     line = robot.lidar.read_line(1.0)
    >>> line.ranges.shape == robot.lidar.spec.elevations.shape
    True
    """

    base: DriveBase
    lidar: Lidar
    clock: Clock
    T_base_lidar: FloatArray = field(default_factory=default_mount)
    turntable: Turntable | None = None
    T_base_axis: FloatArray | None = None
