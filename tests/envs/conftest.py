"""Small environments: one scene that the robot is done with in a few views."""

import gymnasium
import pytest

import scan3d_twin.envs


@pytest.fixture
def make():
    """Make an environment without wrappers, closed at the end."""
    made = []

    def build(name="ViewPlanOverlap", **options):
        options = {"scene": "three_boxes", "fidelity": "kinematic", **options}
        env = gymnasium.make(f"scan3d_twin/{name}-v0", **options).unwrapped
        made.append(env)
        return env

    assert scan3d_twin.envs.ENV_IDS
    yield build
    for env in made:
        env.close()
