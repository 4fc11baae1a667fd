"""A bare floor, so that nothing but the floor acts on the robot."""

import numpy as np
import pytest

from scan3d_twin.sim.config import IDEAL_ROBOT, RobotErrorConfig
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.world import RobotErrors, World, build_model

BARE = """<mujoco>
  <worldbody>
    <geom name="target" type="box" size=".1 .1 .1" pos="50 0 .1"/>
    <site name="spawn"/>
  </worldbody>
</mujoco>"""


@pytest.fixture(scope="session")
def bare(tmp_path_factory):
    """The scene with nothing near the robot."""
    path = tmp_path_factory.mktemp("scenes") / "bare.xml"
    path.write_text(BARE)
    return load_scene(str(path))


@pytest.fixture
def scene_of(tmp_path):
    """Load a scene from the inside of its worldbody."""

    def load(body, head="", spawn='<site name="spawn"/>'):
        """Return the scene with this ``body``."""
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco>{head}<worldbody>{spawn}{body}</worldbody></mujoco>")
        return load_scene(str(path))

    return load


def make_world(scene, errors: RobotErrorConfig = IDEAL_ROBOT, seed: int = 0) -> World:
    """Return a running world with one robot drawn from ``errors``."""
    robot = RobotErrors.draw(errors, np.random.default_rng(seed))
    return World(scene, build_model(scene, "create2", robot))


@pytest.fixture(name="make_world")
def _make_world():
    return make_world
