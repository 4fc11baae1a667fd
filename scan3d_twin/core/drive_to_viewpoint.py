"""The drive to the next viewpoint, around obstacles that the lidar sees or the bumper touches.

Glass, black posts and things lower than the beams are found only by the bumper. The base then stops
its wheels at once; the robot backs off along the way it came, marks an obstacle where it touched
something, takes a panorama and finds another path. Only bumps and blocked wheels are treated in
this way: a cliff, a lifted wheel, an overcurrent or a low battery end the run.
"""

from __future__ import annotations

import math

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import HazardError, MotionTimeoutError, ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.costmap import RESOLUTION, build_costmap
from scan3d_twin.core.navigation.motion_control import back_off, follow_path
from scan3d_twin.core.observer import Observer
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Hazards, Observation, Pose2

BACK_OFF_LENGTH = 0.12
"""Distance driven back after a bump [m]: the robot then has its clearance from the obstacle."""
BUMPER_SIDE_BEARING = math.radians(45.0)
"""Assumed bearing of a contact on one half of the bumper, which does not say where on it [rad]."""
CONTACT_HALF_WIDTH = 0.10
"""Assumed half width of an obstacle at its first contact [m], along the body there. Each further
bump on the same drive doubles it, so that a few bumps get the robot round a long pane."""

Place = tuple[float, float]
"""A place (x, y) in ``odom`` [m]."""


def drive(
    robot: Robot, viewpoint: Pose2, session: Session, observer: Observer
) -> tuple[Place, ...]:
    """Drive to ``viewpoint`` in ``odom``; return the places in ``odom`` touched on the way.

    Raises:
        ScanError: There is no path, or none is left after ``config.motion.bump_retries`` bumps.
        HazardError: Not a bump, or one bump too many; the wheels are stopped.
    """
    config, seen = session.config, session.observations()
    touched: list[Place] = []
    for tries_left in range(config.motion.bump_retries, -1, -1):
        # Find a path, by a panorama if need be
        path = _find_path(robot, viewpoint, seen, touched, session)
        if path is None and tries_left:
            observer.on_event("the way is blocked: looking around for another one")
            seen = (*seen, take_panorama(robot, config, observer.on_line))
            path = _find_path(robot, viewpoint, seen, touched, session)
        if path is None:
            break

        # Follow it until something is touched
        try:
            follow_path(robot, path, config.motion)
            return tuple(touched)
        except (HazardError, MotionTimeoutError):
            hazards = robot.base.hazards()
            if not tries_left or not _is_only_bumped(hazards):
                raise
            half_width = CONTACT_HALF_WIDTH * 2 ** (config.motion.bump_retries - tries_left)
            touched += _locate_contacts(
                robot.base.odometry().T_odom_base, hazards, half_width, config
            )

        # Back off and look for another path
        observer.on_event(f"{_describe(hazards)}: backing off to find a way around")
        back_off(robot, BACK_OFF_LENGTH, config.motion)
        seen = (*seen, take_panorama(robot, config, observer.on_line))
    raise ScanError(f"no way to the viewpoint at ({viewpoint.x:.2f}, {viewpoint.y:.2f}) m")


def _find_path(
    robot: Robot,
    viewpoint: Pose2,
    seen: tuple[Observation, ...],
    touched: list[Place],
    session: Session,
) -> FloatArray | None:
    """Return the waypoints (n, 2) in ``odom`` [m], or None."""
    here = robot.base.odometry().T_odom_base
    costmap = build_costmap(seen, session.config, here, touched, session.workspace)
    return costmap.find_path(viewpoint.x, viewpoint.y)


def _is_only_bumped(hazards: Hazards) -> bool:
    """Return whether no hazard but the bumper is active; without any, a wheel is blocked."""
    return set(hazards.active()) <= {"bump left", "bump right"}


def _describe(hazards: Hazards) -> str:
    """Return in words what stopped the robot."""
    names = hazards.active()
    return f"touched something ({', '.join(names)})" if names else "the wheels are blocked"


def _locate_contacts(
    here: Pose2, hazards: Hazards, half_width: float, config: Config
) -> list[Place]:
    """Return places in ``odom`` where the obstacle that was touched may be, beside the body."""
    bearing = BUMPER_SIDE_BEARING * (hazards.bump_left - hazards.bump_right)
    outside = here @ Pose2(0.0, 0.0, bearing) @ Pose2(config.motion.robot_radius + RESOLUTION)
    along = np.arange(-half_width, half_width + 1e-9, RESOLUTION)
    places = outside.apply(np.column_stack([np.zeros(len(along)), along]))
    return [(float(x), float(y)) for x, y in places]
