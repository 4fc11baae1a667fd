"""Several targets in one scene: one after the other, each as a session of its own."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.drive_to_viewpoint import drive
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.observer import Observer
from scan3d_twin.core.planning import Planner
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.scanning.target_extraction import find_targets
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2

Place = tuple[float, float]
"""Where a target stands: (x, y) in ``odom`` [m]."""


def digitize_each(
    robot: Robot, planner: Planner, config: Config, seed: int, observer: Observer, count: int
) -> Iterator[Session]:
    """Digitise the ``count`` most salient things that stand free; yield each one's session.

    The targets are chosen by one look around, most salient first. After each of them the robot
    drives back to where it began, looks again and goes on with the next: what it saw there is the
    floor it knows, and the odometry frame stays the same, so that the models lie beside each other
    as well as the odometry tells. There may be fewer targets than asked for.

    Raises:
        SceneError: There is no target.
        TwinError: Whatever ends the digitising of one; the targets after it are not tried.
    """
    start = robot.base.odometry().T_odom_base
    observer.on_event(f"looking around for {count} targets")
    places = find_places(robot, config, observer, count)
    for k, place in enumerate(places):
        observer.on_event(f"target {k} at ({place[0]:.2f}, {place[1]:.2f}) m")
        session = run_loop(robot, planner, config, seed, observer, place)
        yield session
        if k + 1 < len(places):
            observer.on_event("driving back to where it began")
            drive_back(robot, start, session, observer)


def find_places(robot: Robot, config: Config, observer: Observer, count: int) -> list[Place]:
    """Return where the ``count`` most salient things stand, or fewer; most salient first.

    Raises:
        SceneError: There is no target.
    """
    start = robot.base.odometry().T_odom_base
    hints = find_targets(take_panorama(robot, config, observer.on_line), count, config)
    return [_nearest_point(hint, np.array([start.x, start.y])) for hint in hints]


def drive_back(robot: Robot, start: Pose2, session: Session, observer: Observer) -> None:
    """Drive to ``start`` over the floor that the views of ``session`` know."""
    drive(robot, start, session, observer)


def _nearest_point(hint: FloatArray, start: FloatArray) -> Place:
    """Return the point of a top view (n, 2) that is nearest to ``start`` (2,)."""
    x, y = hint[np.argmin(np.linalg.norm(hint - start, axis=1))]
    return float(x), float(y)
