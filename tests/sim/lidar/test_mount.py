"""A lidar that is mounted wrong on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.sim.config import IDEAL_ROBOT, TwinConfig
from scan3d_twin.sim.robot import open_sim

LATERAL, ROLL, PITCH = 0.012, 0.02, -0.03


def pose_of_lidar(twin: TwinConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return the true position and attitude of the lidar."""
    with open_sim("plain_wall", 0, twin) as (robot, truth):
        robot.clock.sleep(0.2)
        robot.lidar.read_line(1.0)
        evidence = truth.evidence()
    return evidence.positions[0], evidence.directions[0]


def test_the_lidar_is_where_it_is_told_to_be() -> None:
    wrong = replace(IDEAL_ROBOT, mount_lateral=LATERAL, mount_roll=ROLL, mount_pitch=PITCH)
    (p, d), (q, e) = (
        pose_of_lidar(replace(TwinConfig.ideal(), errors=errors)) for errors in (IDEAL_ROBOT, wrong)
    )
    assert q - p == pytest.approx([0.0, LATERAL, 0.0], abs=2e-4)
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(ROLL), -np.sin(ROLL)], [0, np.sin(ROLL), np.cos(ROLL)]]
    )
    c, s = np.cos(PITCH), np.sin(PITCH)
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    assert e == pytest.approx(about_y @ about_x @ d, abs=1e-3)


@pytest.mark.parametrize("name", ["mount_lateral", "mount_roll", "mount_pitch", "mount_yaw"])
def test_an_impossible_mount_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=name):
        replace(IDEAL_ROBOT, **{name: 1.0})
