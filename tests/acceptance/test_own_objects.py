"""Things that users bring: at a wall, and thinner than a sweep's lines are apart."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import digitize
from scan3d_twin.core.model.evaluation import Evaluation, evaluate
from scan3d_twin.core.session import Session
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.scene import Scene

pytestmark = pytest.mark.slow

AT_WALL = """
<mujoco><custom><text name="scan3d.tour" data="full"/></custom><worldbody>
  <geom name="floor" type="plane" size="5 5 0.1"/>
  <geom name="north" type="box" pos="0 2.55 1.25" size="3 0.05 1.25"/>
  <geom name="south" type="box" pos="0 -2.55 1.25" size="3 0.05 1.25"/>
  <geom name="east" type="box" pos="0.45 0 1.25" size="0.05 2.6 1.25"/>
  <geom name="west" type="box" pos="-4.55 0 1.25" size="0.05 2.6 1.25"/>
  <geom name="target" type="box" pos="0.2 0 0.35" size="0.2 0.35 0.35"/>
  <site name="spawn" pos="-1.7 0 0"/>
</worldbody></mujoco>
"""


def tour(
    scene: Scene, seed: int, look_rate: float = Config().sweep.look_rate
) -> tuple[Session, Evaluation]:
    """Digitise the target of ``scene`` all round."""
    config = Config(tour="full")
    config = replace(config, sweep=replace(config.sweep, look_rate=look_rate))
    with open_sim(scene, seed) as (robot, truth):
        session = digitize(robot, config, seed=seed)
        return session, evaluate(session, truth)


def test_both_sides_of_a_thing_at_a_wall_are_scanned_and_not_the_wall(tmp_path: Path) -> None:
    path = tmp_path / "at_wall.xml"
    path.write_text(AT_WALL)
    session, result = tour(load_scene(str(path)), 1001)
    assert session.stop_reason.startswith("no viewpoint left")
    assert len(session.views) < 10
    assert result.coverage > 0.9
    assert result.f_score[0.020] > 0.9


def test_a_pole_thinner_than_four_lines_is_scanned(tmp_path: Path) -> None:
    path = tmp_path / "pole.stl"
    trimesh.creation.cylinder(0.015, 1.0, sections=48).export(path)
    # Lines of the usual look around are 5 cm apart at 1.5 m, and miss it or not
    session, result = tour(load_scene(str(path)), 1001, math.radians(6.0))
    assert max(len(np.unique(view.target.lines)) for view in session.views) <= 8
    assert not session.stop_reason.startswith("target lost")
    assert result.coverage > 0.8
