"""Every knob of the twin: nested frozen dataclasses in SI units, defaults with their source.

Importing this module costs nothing (no numpy), so that ``twin --help`` can list the options.
Default is the `typical` robot: each seed draws its own errors from these distributions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from scan3d_twin.core.config import MountConfig, Pattern
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.options import check_options, number, repr_options
from scan3d_twin.devices.registry import (
    DEFAULT_BASE,
    DEFAULT_LIDAR,
    Devices,
    base_device,
    lidar_device,
)
from scan3d_twin.sim.lidar.config import (
    HARSH_LIDAR,
    IDEAL_LIDAR,
    UNFILTERED_LIDAR,
    LidarModelConfig,
)
from scan3d_twin.sim.turntable.model import DEFAULT_TURNTABLE, find_turntable

__all__ = ["IDEAL_LIDAR", "IDEAL_ROBOT", "LidarModelConfig", "RobotErrorConfig", "TwinConfig"]

if TYPE_CHECKING:
    from scan3d_twin.devices.device import ConfigTables

T = TypeVar("T", LidarModelConfig, "RobotErrorConfig")
Reckoning = Literal["driver", "wheels"]


@dataclass(frozen=True, slots=True)
class RobotErrorConfig:
    """How far a robot is from its nominal self; drawn once per seed.

    Wheel errors and friction give 1.9 deg/m of heading drift and .8 deg in a 90 deg turn (standard
    deviations), typical of the Create; MuJoCo's slip alone gives a tenth of that.
    """

    wheel_radius: float = number(0.006, 0.0, 0.05)
    """Relative error of each wheel's radius, standard deviation; tyre wear and load."""
    wheel_base: float = number(0.01, 0.0, 0.05)
    """Relative error of the wheel base, standard deviation; contact patch of the tyres."""
    friction_min: float = number(0.5, most=2.0)
    """Lowest sliding friction of the tyres; smooth floor."""
    friction_max: float = number(0.9, most=2.0)
    """Highest sliding friction of the tyres; carpet."""
    cogging: float = number(0.03, 0.0, 0.1)
    """Amplitude of the wheel torque's cogging [N m]; .02 to .04 shake the scan plane by .01 deg."""

    uneven: float = number(0.0, 0.0, 0.01)
    """Unevenness of plane floors, standard deviation of the height [m]."""
    uneven_length: float = number(0.3, 0.1, 2.0)
    """Length over which an uneven floor changes [m]; assumption, parquet and carpet edges."""
    mount_lateral: float = number(0.0, -0.05, 0.05)
    """The lidar sits this far to the left of where it should [m]."""
    mount_roll: float = number(0.0, -0.2, 0.2)
    """It leans to its right by this, about the axis ahead [rad]."""
    mount_pitch: float = number(0.0, -0.2, 0.2)
    """It looks down by this, about the axis to the left [rad]."""
    mount_yaw: float = number(0.0, -0.2, 0.2)
    """It is turned to the left by this, about the vertical axis [rad]."""
    axis_roll: float = number(0.0, -0.2, 0.2)
    """The axis of the turntable leans to the right of the robot by this [rad]."""
    axis_pitch: float = number(0.0, -0.2, 0.2)
    """The axis of the turntable is tipped forwards by this [rad]."""
    table_play: float = number(1.0, 0.0, 5.0)
    """Factor of the play of the turntable; 1 is that of its model."""
    battery_life: float = number(7200.0, 1.0, 1e9)
    """Time in which the battery is drained [s]; about 2 h, as in the paper."""
    reckoning: Reckoning = "driver"
    """create1: odometry as the driver reckons it (driver), by commands that packets 19 and 20
    correct at rest, or by what the wheels turned (wheels), as an emulator of the base needs it."""
    truncates: bool = True
    """create1: packets 19 and 20 lose the fraction at each read (libcreate issue 22)."""
    angle_gain: float = number(1.0, 0.0, 2.0)
    """create1: factor of packet 20; .25 on firmware 2012-03-22 (robotics.stackexchange 7121)."""
    distance_unsigned: bool = False
    """create1: packet 19 grows in reverse too (answers.ros.org 12338)."""

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self, "errors")
        if self.friction_min > self.friction_max:
            raise ConfigError(
                "errors.friction_min must be <= errors.friction_max, got "
                f"{self.friction_min:g} and {self.friction_max:g}"
            )


IDEAL_ROBOT = RobotErrorConfig(
    wheel_radius=0.0,
    wheel_base=0.0,
    friction_min=0.7,
    friction_max=0.7,
    cogging=0.0,
    battery_life=1e9,
    truncates=False,
)
"""A robot that is exactly its data sheet; it still slips as the physics has it."""

HARSH_ROBOT = RobotErrorConfig(
    wheel_radius=0.012,
    wheel_base=0.02,
    friction_min=0.3,
    friction_max=1.2,
    cogging=0.05,
    uneven=0.001,
    battery_life=3600.0,
)
"""Worn tyres, an old battery and a bad floor: twice the errors of a `typical` one; assumption."""


@dataclass(frozen=True, slots=True)
class TwinConfig:
    """The twin of the robot, its lidar and their errors; ``of`` knows those of each device.

    >>> exact = s3d.TwinConfig.of("ideal")
    >>> with s3d.open_sim("three_boxes", seed=0, config=exact) as (robot, truth):
    ...     robot.base.odometry().T_odom_base
    Pose2(x=0.0, y=0.0, yaw=0.0)
    """

    robot: str = DEFAULT_BASE
    """Name of the base."""
    lidar_model: str = DEFAULT_LIDAR
    """Name of the lidar."""
    lidar_link: str = ""
    """How the lidar is connected: one of its links; where it is given empty, the first."""
    pattern: Pattern = "yaw-base"
    """What turns the plane of the lidar: the base about the vertical (yaw-base, as in the paper),
    or a turntable about the vertical (yaw), the axis to the left (pitch) or that ahead (roll)."""
    turntable: str = DEFAULT_TURNTABLE
    """Name of the turntable: xl330 or ideal. With the pattern yaw-base there is none."""
    lidar_yaw: float = number(0.0, -math.pi, math.pi)
    """Turn of the lidar to the left on its mount, which the robot knows, unlike errors.mount_roll
    [rad]; then lidar_pitch, then lidar_roll."""
    lidar_pitch: float = number(0.0, -math.pi, math.pi)
    """Turn of the lidar downwards on its mount [rad]."""
    lidar_roll: float = number(0.0, -math.pi, math.pi)
    """Turn of the lidar to its right on its mount [rad]."""
    lidar: LidarModelConfig = field(default_factory=LidarModelConfig)
    errors: RobotErrorConfig = field(default_factory=RobotErrorConfig)

    __repr__ = repr_options

    def __post_init__(self) -> None:
        check_options(self)
        find_turntable(self.turntable)
        devices = self.devices
        object.__setattr__(self, "robot", devices.base)
        object.__setattr__(self, "lidar_model", devices.lidar)
        object.__setattr__(self, "lidar_link", devices.link)

    @property
    def turn(self) -> MountConfig:
        """How the lidar is turned on its mount."""
        return MountConfig(roll=self.lidar_roll, pitch=self.lidar_pitch, yaw=self.lidar_yaw)

    @property
    def devices(self) -> Devices:
        """What the robot is made of."""
        return Devices(self.robot, self.lidar_model, self.lidar_link)

    @classmethod
    def ideal(cls, lidar_link: str = "") -> TwinConfig:
        """Return a robot and a lidar without errors, for tests."""
        return cls.of("ideal", lidar_link=lidar_link)

    @classmethod
    def of(
        cls,
        world: str,
        robot: str = DEFAULT_BASE,
        lidar: str = DEFAULT_LIDAR,
        lidar_link: str = "",
    ) -> TwinConfig:
        """Return the twin of these devices in the named ``world``.

        Worlds are ideal, typical, harsh, and unfiltered: typical with the lidar noise that was
        assumed up to commit e3444ed, to compare with older figures.

        What the devices say about their own errors holds where the world is typical.

        Raises:
            UnknownNameError: There is no such world or device.
            ConfigError: A device states an option that there is not, or a wrong value.
        """
        if world not in WORLDS:
            raise UnknownNameError("world", world, WORLDS)
        devices = Devices(robot, lidar, lidar_link)
        stated = [base_device(devices.base).options, lidar_device(devices.lidar).options]
        lidar_errors, robot_errors = WORLDS[world]
        return cls(
            robot=devices.base,
            lidar_model=devices.lidar,
            lidar_link=devices.link,
            lidar=_apply_stated("lidar", stated, lidar_errors),
            errors=_apply_stated("errors", stated, robot_errors),
        )


def _apply_stated(section: str, stated: Sequence[ConfigTables], errors: T) -> T:
    """Return ``errors`` with what devices state in a ``section``, where they are typical."""
    fixed = find_fixed(errors)
    known = {each.name for each in fields(errors)}
    changes: dict[str, Any] = {}
    for name, value in (each for tables in stated for each in tables.get(section, {}).items()):
        if name not in known:
            raise UnknownNameError("option", f"{section}.{name}", known)
        if name not in fixed:
            changes[name] = value
    return replace(errors, **changes)


def find_fixed(errors: LidarModelConfig | RobotErrorConfig) -> frozenset[str]:
    """Return the names of the fields that ``errors`` of a world fix, whatever devices state.

    Those are the fields that are not typical, and in the ideal world those that are 0: there is no
    such error, neither of the typical devices nor of others.
    """
    typical = type(errors)()
    is_ideal = errors in (IDEAL_LIDAR, IDEAL_ROBOT)
    values = {each.name: getattr(errors, each.name) for each in fields(errors)}
    return frozenset(
        name
        for name, value in values.items()
        if value != getattr(typical, name) or (is_ideal and value == 0)
    )


DEFAULT_WORLD = "typical"
WORLDS = {
    "ideal": (IDEAL_LIDAR, IDEAL_ROBOT),
    DEFAULT_WORLD: (LidarModelConfig(), RobotErrorConfig()),
    "harsh": (HARSH_LIDAR, HARSH_ROBOT),
    "unfiltered": (UNFILTERED_LIDAR, RobotErrorConfig()),
}
"""Lidar and robot errors by the name of the world."""
