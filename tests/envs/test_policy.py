"""Planners as policies do what they do in ``digitize``."""

import numpy as np
import pytest

from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.mapping.loop_closure import align_final
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.envs import PlannerPolicy, rollout
from scan3d_twin.run.resolve import settings_for_scene
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

QUICK = {"sweep": {"width": 0.7, "yaw_rate": 0.35, "look_rate": 0.7}, "max_views": 3}


@pytest.mark.parametrize("planner", ["siicp", "fixed50"])
def test_an_episode_with_physics_is_a_run_of_digitize(make, planner):
    env = make(fidelity="physics", options=QUICK, goal=1.0, rewards={"failure": 0.0})
    rollout(env, PlannerPolicy(planner), seed=7)
    session = env.session
    scene = load_scene("three_boxes")
    config = settings_for_scene(scene, QUICK).config
    with open_sim(scene, session.seed) as (robot, _):
        run = run_loop(robot, make_planner(planner), config, session.seed, Unobserved())
    assert len(session.views) > 1
    for ours, theirs in zip(align_final(session).views, run.views, strict=True):
        assert np.array_equal(
            ours.observation.image.ranges, theirs.observation.image.ranges, equal_nan=True
        )
        assert ours.T_world_scan == theirs.T_world_scan


@pytest.mark.parametrize("name", ["ViewPlanOverlap", "ViewPlanPose", "Candidates"])
@pytest.mark.parametrize("planner", ["fixed80", "random"])
def test_any_planner_acts_in_any_environment(make, name, planner):
    env = make(name, options={"max_views": 3})
    done = rollout(env, PlannerPolicy(planner), seed=1)
    assert done.total == pytest.approx(sum(done.rewards))
    assert done.info["views"] == len(done.rewards) + 1


def test_a_higher_overlap_takes_more_views(make):
    views = [
        rollout(make(rewards={"failure": 0.0}), PlannerPolicy(name), seed=2).info["views"]
        for name in ("fixed20", "fixed80")
    ]
    assert views[0] < views[1]


def test_an_unknown_planner():
    with pytest.raises(UnknownNameError, match="siicp"):
        PlannerPolicy("oracle of delphi")


def test_another_environment():
    import gymnasium

    with pytest.raises(ConfigError, match=r"scan3d_twin\.envs"):
        PlannerPolicy("fixed50").act(gymnasium.make("CartPole-v1"))
