"""Several targets in one scene: where they stand, and the way back from one to the next.

One panorama chooses the targets. After each of them the robot drives back to where it began and
goes on with the next one. The odometry frame stays the same, so that the models lie beside each
other as well as odometry allows.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.drive_to_viewpoint import drive
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.observer import Observer
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.scanning.target.selection import find_targets
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2

Place = tuple[float, float]
"""Where a target stands: (x, y) in ``odom`` [m]."""


def find_places(robot: Robot, config: Config, observer: Observer, count: int) -> list[Place]:
    """Return where the ``count`` most salient things stand, or fewer; most salient first.

    Raises:
        SceneError: There is no target.
    """
    start = robot.base.odometry().T_odom_base
    hints = find_targets(take_panorama(robot, config, observer.on_line), count, config)
    return [_find_nearest_point(hint, np.array([start.x, start.y])) for hint in hints]


def drive_back(robot: Robot, start: Pose2, session: Session, observer: Observer) -> None:
    """Drive to ``start`` in ``odom`` over the floor that the views of ``session`` have shown."""
    drive(robot, start, session, observer)


def _find_nearest_point(hint: FloatArray, start: FloatArray) -> Place:
    """Return the point of a top view (n, 2) that is nearest to ``start`` (2,)."""
    x, y = hint[np.argmin(np.linalg.norm(hint - start, axis=1))]
    return float(x), float(y)
