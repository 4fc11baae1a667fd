from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paper import paper_config
from synthetic import Box, observe
from two_targets import TWO

from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.multi_target import drive_back, find_places
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.scanning.target.selection import find_targets
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

pytestmark = pytest.mark.slow

NEAR = Box((1.3, 0.5, 0.0), (1.7, 1.1, 0.6))
SMALL = Box((1.3, -0.9, 0.0), (1.5, -0.6, 0.4))


def middles(hints: list[FloatArray]) -> list[float]:
    """Return the median y of each target."""
    return [float(np.median(hint[:, 1])) for hint in hints]


def test_the_most_salient_comes_first_and_walls_are_no_targets() -> None:
    look = observe(Pose2(), (NEAR, SMALL), width=math.tau - 1e-3, step=math.radians(2.0))
    found = find_targets(look, 5, paper_config())
    assert len(found) == 2
    first, second = middles(found)
    assert first > 0.4
    assert second < -0.4
    assert middles(find_targets(look, 1, paper_config())) == [first]


def test_an_empty_floor_has_no_targets() -> None:
    look = observe(Pose2(), (), room=False, width=math.tau - 1e-3, step=math.radians(2.0))
    with pytest.raises(SceneError):
        find_targets(look, 2, paper_config())


def test_the_robot_finds_two_targets_and_drives_back_between_them(tmp_path: Path) -> None:
    path = tmp_path / "two.xml"
    path.write_text(TWO)
    config = replace(paper_config(), max_views=2)
    with open_sim(load_scene(str(path)), 0, TwinConfig.ideal()) as (robot, _):
        start = robot.base.odometry().T_odom_base
        places = find_places(robot, config, Unobserved(), 2)
        session = run_loop(robot, make_planner("fixed50"), config, 0, Unobserved(), places[0])
        drive_back(robot, start, session, Unobserved())
        assert robot.base.odometry().T_odom_base.distance(start) < 0.05
    for place, expected in zip(places, [(1.3, 0.9), (1.35, -0.8)], strict=True):
        assert np.hypot(*np.subtract(place, expected)) < 0.5
    points = np.concatenate([v.T_world_scan.apply(v.target.points) for v in session.views])
    assert np.median(points[:, 0]) == pytest.approx(1.3, abs=0.1)
    assert np.median(points[:, 1]) == pytest.approx(0.9, abs=0.25)
