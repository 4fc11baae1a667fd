"""Where the robot drove, laid through the viewpoints as the alignment places them."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray


def place_track(track: FloatArray, session: Session) -> FloatArray:
    """Return the poses x, y [m], yaw [rad] (n, 3) in ``world`` of a ``track``, see ``Journey``.

    At each view the odometry is corrected as the view was; in between the corrections change evenly
    with time, before the first view and after the last they do not.
    """
    if len(track) == 0 or not session.views:
        return np.zeros((0, 3))

    # Correction of the odometry at each view
    times, corrections = [], []
    for view in session.views:
        correction = view.T_world_odom
        times.append(float(view.observation.image.stamps.max()))
        corrections.append((correction.x, correction.y, correction.yaw))
    values = np.array(corrections)
    values[:, 2] = np.unwrap(values[:, 2])

    # Apply them to the poses
    x, y, yaw = (np.interp(track[:, 0], times, values[:, i]) for i in range(3))
    cos, sin = np.cos(yaw), np.sin(yaw)
    east, north = track[:, 1], track[:, 2]
    return np.stack(
        [x + cos * east - sin * north, y + sin * east + cos * north, track[:, 3] + yaw], axis=1
    )
