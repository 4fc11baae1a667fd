"""The drive to the next viewpoint, around what the lidar sees and what it does not.

Glass, black posts and things lower than the beams are found by the bumper. The base stops its
wheels itself at once; then the robot backs off along the way it came, takes what it touched for an
obstacle, looks around and finds another way. Only bumps and blocked wheels are treated so: a cliff,
a lifted wheel, an overcurrent or a low battery end the run.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import HazardError, MotionTimeoutError, ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.costmap import RESOLUTION, build_costmap
from scan3d_twin.core.navigation.motion_control import back_off, follow
from scan3d_twin.core.observer import Observer
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Hazards, Observation, Pose2

BACK_OFF = 0.12
"""Way back after a bump [m]: the robot then has its clearance from what it touched."""
SIDE = math.radians(45.0)
"""Bearing of what pressed one half of the bumper, which does not say where on it."""
HALF_WIDTH = 0.10
"""What is touched is taken to go on so far to either side [m], along the body there; at every bump
more on the same drive for twice as far, so that few get the robot round a long pane."""

Place = tuple[float, float]


def drive(
    robot: Robot, viewpoint: Pose2, session: Session, observer: Observer
) -> tuple[Place, ...]:
    """Drive to ``viewpoint`` in ``odom``; return the places (x, y) in ``odom`` touched on the way.

    Raises:
        ScanError: There is no way, or none is left after ``config.motion.bump_retries`` bumps.
        HazardError: Something else than a bump, or one bump too many; the wheels are stopped.
    """
    config, seen = session.config, session.observations()
    touched: list[Place] = []
    for tries_left in range(config.motion.bump_retries, -1, -1):
        path = _way(robot, viewpoint, seen, touched, config)
        if path is None and tries_left:
            observer.on_event("the way is blocked: looking around for another one")
            seen = (*seen, take_panorama(robot, config, observer.on_line))
            path = _way(robot, viewpoint, seen, touched, config)
        if path is None:
            break
        try:
            follow(robot, path, config.motion)
            return tuple(touched)
        except (HazardError, MotionTimeoutError):
            hazards = robot.base.hazards()
            if not tries_left or not _only_bumped(hazards):
                raise
            half_width = HALF_WIDTH * 2 ** (config.motion.bump_retries - tries_left)
            touched += _contacts(robot.base.odometry().T_odom_base, hazards, half_width, config)
        observer.on_event(f"{_words(hazards)}: backing off to find a way around")
        back_off(robot, BACK_OFF, config.motion)
        seen = (*seen, take_panorama(robot, config, observer.on_line))
    raise ScanError(f"no way to the viewpoint at ({viewpoint.x:.2f}, {viewpoint.y:.2f}) m")


def _way(
    robot: Robot,
    viewpoint: Pose2,
    seen: tuple[Observation, ...],
    touched: list[Place],
    config: Config,
) -> FloatArray | None:
    """Return the waypoints (n, 2) in ``odom`` [m], or None."""
    here = robot.base.odometry().T_odom_base
    return build_costmap(seen, config, here, touched).path(viewpoint.x, viewpoint.y)


def _only_bumped(hazards: Hazards) -> bool:
    """Tell whether nothing is wrong but the bumper, or nothing at all: then a wheel is blocked."""
    return set(hazards.active()) <= {"bump left", "bump right"}


def _words(hazards: Hazards) -> str:
    names = hazards.active()
    return f"touched something ({', '.join(names)})" if names else "the wheels are blocked"


def _contacts(here: Pose2, hazards: Hazards, half_width: float, config: Config) -> list[Place]:
    """Return where what was touched may stand, just outside of the body, in ``odom``."""
    bearing = SIDE * (hazards.bump_left - hazards.bump_right)
    outside = here @ Pose2(0.0, 0.0, bearing) @ Pose2(config.motion.robot_radius + RESOLUTION)
    along = np.arange(-half_width, half_width + 1e-9, RESOLUTION)
    places = outside.apply(np.column_stack([np.zeros(len(along)), along]))
    return [(float(x), float(y)) for x, y in places]
