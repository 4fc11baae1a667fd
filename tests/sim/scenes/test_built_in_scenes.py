"""What the built-in scenes promise."""

import math
from contextlib import suppress

import numpy as np
import pytest

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.types import VALID
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene, scene_names

WANTED = {
    "clutter_100",
    "concave_u",
    "corridor",
    "cylinder",
    "ledge",
    "living_room",
    "plain_wall",
    "shiny_cylinder",
    "shiny_drum",
    "sine_box",
    "steps",
    "three_boxes",
}


def test_all_are_there():
    assert set(scene_names()) == WANTED


@pytest.mark.parametrize("name", sorted(WANTED))
def test_the_robot_can_stand_turn_and_see_the_target(name):
    with open_sim(name, 0, TwinConfig.ideal()) as (robot, truth):
        robot.base.set_velocity(0.0, math.radians(60))
        robot.clock.sleep(1.0)
        seen = set()
        for _ in range(50):
            robot.lidar.read_line(1.0)
            evidence = truth.evidence()
            seen |= {truth._scene.model.geom(k).name for k in evidence.geoms if k >= 0}
        assert not robot.base.hazards().active()
    assert seen & set(load_scene(name).target_geoms)


def test_clutter_holds_a_hundred_things():
    model = load_scene("clutter_100").model
    names = {model.geom(k).name for k in range(model.ngeom)}
    assert len({name[:9] for name in names if name.startswith("thing_")}) == 100


def test_the_cliff_sensors_keep_the_robot_on_the_ledge():
    for turn in (math.pi / 2, -math.pi / 2, math.pi):
        with open_sim("ledge", 0, TwinConfig.ideal()) as (robot, truth):
            robot.base.set_velocity(0.0, math.copysign(1.0, turn))
            robot.clock.sleep(abs(turn))
            robot.base.set_velocity(0.3, 0.0)
            with pytest.raises(HazardError, match="cliff"):
                robot.clock.sleep(10.0)
            for _ in range(4):  # while it comes to rest its other sensors reach the edge
                with suppress(HazardError):
                    robot.clock.sleep(0.5)
            height = robot.base._world.data.body("robot/base").xpos[2]
            assert height == pytest.approx(0.0, abs=0.005)
            assert abs(truth.pose_at(robot.clock.now()).y) < 1.6


def test_the_drum_blinds_and_loses_the_sensor():
    with open_sim("shiny_drum", 0) as (robot, truth):
        codes, lost, hits = [], 0, 0
        robot.base.set_velocity(0.0, math.radians(-12))
        robot.clock.sleep(1.0)
        robot.base.set_velocity(0.0, math.radians(12))
        robot.clock.sleep(0.2)
        drum = truth._scene.model.geom("drum_shell").id
        for _ in range(20):
            line = robot.lidar.read_line(1.0)
            shell = truth.evidence().geoms == drum
            hits, lost = hits + shell.sum(), lost + (shell & (line.codes != VALID)).sum()
            codes += line.codes[line.codes >= 0].tolist()
    assert hits > 100
    assert 0.3 < lost / hits < 0.95
    assert np.bincount(codes)[0] > 0
