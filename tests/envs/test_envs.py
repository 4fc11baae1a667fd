"""Environments follow gymnasium, show the truth in infos only, and are deterministic."""

import gc
import warnings
import weakref

import numpy as np
import pytest
from gymnasium import error
from gymnasium.utils.env_checker import check_env, data_equivalence

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.envs import ENV_IDS
from scan3d_twin.envs.overlap import OverlapEnv
from scan3d_twin.envs.scoring import Score

NAMES = [name.split("/")[1].removesuffix("-v0") for name in ENV_IDS]


def play(env, seed, steps=4):
    """Observations, rewards, ends and infos of a few sampled actions."""
    env.action_space.seed(seed)
    seen = [env.reset(seed=seed)]
    for _ in range(steps):
        step = env.step(env.action_space.sample())
        seen.append(step)
        if step[2] or step[3]:
            break
    return seen


def quietly_checked(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env, skip_render_check=True)


def test_gymnasium_has_nothing_to_say_of_random_scenes(make):
    quietly_checked(make(scene="random"))


@pytest.mark.parametrize("fidelity", ["lite", "physics"])
def test_the_same_rules_with_physics(make, fidelity):
    quick = {"sweep": {"width": 0.7, "yaw_rate": 0.35, "look_rate": 0.7}, "max_views": 3}
    env = make(fidelity=fidelity, options=quick)
    one, two = play(env, 3, 1), play(env, 3, 1)
    assert data_equivalence(one, two)
    assert all(env.observation_space.contains(step[0]) for step in one)
    assert one[-1][-1]["sim_time"] > 20.0


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_bits(make, name):
    one, two = play(make(name, scene="random"), 5), play(make(name, scene="random"), 5)
    assert data_equivalence(one, two, exact=True)
    other = play(make(name, scene="random"), 6)
    assert not data_equivalence(one, other)


def test_no_truth_in_what_the_agent_sees(make, monkeypatch):
    honest = play(make(goal=1.0), 1)
    monkeypatch.setattr(Score, "coverage", property(lambda score: 0.123))
    monkeypatch.setattr(Score, "_error", lambda score, session, k: 1e-4 * k)
    blind = play(make(goal=1.0), 1)
    shared = min(len(honest), len(blind))
    assert shared > 1
    for a, b in zip(honest[:shared], blind[:shared], strict=True):
        assert data_equivalence(a[0], b[0], exact=True)
    assert blind[1][-1]["coverage"] == 0.123


def test_the_reward_is_the_sum_of_its_terms(make):
    env = make(rewards={"view": 0.5, "misplaced": 0.0})
    _, info = env.reset(seed=2)
    before, driven = info["coverage"], info["path_m"]
    _, reward, *_, info = env.step(env.action_space.sample())
    terms = info["reward_terms"]
    assert reward == pytest.approx(sum(terms.values()))
    assert terms["coverage"] == pytest.approx(info["coverage"] - before)
    assert terms["view"] == -0.5
    assert terms["path"] == pytest.approx(-0.05 * (info["path_m"] - driven))
    assert terms["misplaced"] == 0.0


def test_an_episode_ends_and_says_why(make):
    env = make(options={"max_views": 2})
    env.reset(seed=0)
    _, _, terminated, truncated, info = env.step(np.int64(12))
    assert terminated or truncated
    assert info["ended"]
    assert 0.0 < info["f20"] <= 1.0
    with pytest.raises(error.ResetNeeded):
        env.step(np.int64(0))


@pytest.mark.parametrize(
    ("name", "action"),
    [("ViewPlanOverlap", np.int64(12)), ("ViewPlanPose", np.zeros(3, np.float32))],
)
def test_an_episode_of_as_many_views_as_are_allowed_is_truncated(make, name, action):
    env = make(name, options={"max_views": 2})
    env.reset(seed=0)
    env._lost_view_reason = str
    _, _, terminated, truncated, info = env.step(action)
    assert (terminated, truncated) == (False, True)
    assert info["ended"] == "2 views taken (max_views)"


def test_a_goal_that_is_reached_is_a_success(make):
    env = make(goal=0.05)
    env.reset(seed=0)
    _, _, terminated, truncated, info = env.step(np.int64(8))
    assert (terminated, truncated) == (True, False)
    assert info["is_success"]


@pytest.mark.parametrize("name", ["ViewPlanOverlap", "Candidates"])
def test_masked_actions_are_replaced_and_open_ones_are_not(make, name):
    env = make(name, scene="random")
    for seed in range(4):
        seen, info = env.reset(seed=seed)
        mask = env.action_masks()
        assert mask.any()
        assert np.array_equal(seen["action_mask"], mask)
        assert np.array_equal(info["action_mask"], mask)
        action = np.int64(np.flatnonzero(mask)[-1])
        *_, info = env.step(action)
        assert not info["substituted"]


def test_a_masked_action_is_taken_for_the_nearest_open_one(make, monkeypatch):
    env = make()
    env.reset(seed=0)
    placements = env._placements
    env._placements = [type(placements[0])(None, False)] * 12 + placements[12:]
    *_, info = env.step(np.int64(0))
    assert info["substituted"]
    assert info["eta"] == 0.8


def test_the_costmap_is_laid_anew_by_what_is_seen_and_by_no_plan(make):
    env = make("ViewPlanPose")
    env.reset(seed=0)
    episode, session = env.episode, env.session
    before, here = episode.costmap, session.views[-1].observation.T_odom_scan
    planned = session.with_plan(env.plan_of_action(np.zeros(3, np.float32))[0])
    assert episode.source.costmap_from(here, planned) is before
    seen = planned.with_panorama(session.panoramas[0][1])
    assert episode.source.costmap_from(here, seen) is not before


def test_a_pose_is_snapped_to_where_the_robot_can_stand(make):
    env = make("ViewPlanPose")
    env.reset(seed=0)
    inside = env._odom_of_world @ env.session.views[0].T_world_scan
    here = env.action_of_plan(env.plan_of_action(np.zeros(3, np.float32))[0])
    assert env.action_space.contains(here)
    plan, snapped = env.plan_of_action(np.zeros(3, np.float32))  # in the middle of the target
    assert snapped
    there = env._odom_of_world @ plan.viewpoint
    assert env.episode.costmap.is_feasible(there.x, there.y)
    assert inside.distance(there) < 5.0


@pytest.mark.parametrize("action", [13, -1, 2.5, "half", None])
def test_actions_that_are_none(make, action):
    env = make()
    env.reset(seed=0)
    with pytest.raises(error.InvalidAction, match="Discrete"):
        env.step(action)


@pytest.mark.parametrize(
    "action",
    [
        np.array([0.0, 1.1, 0.0], np.float32),
        np.array([0.0, np.nan, 0.0], np.float32),
        np.zeros(2, np.float32),
        np.zeros(3, np.int64),
    ],
)
def test_poses_that_are_none(make, action):
    env = make("ViewPlanPose")
    env.reset(seed=0)
    with pytest.raises(error.InvalidAction, match="Box"):
        env.step(action)


def test_a_reset_has_no_options(make):
    with pytest.raises(ConfigError, match=r"got scene; .* gymnasium\.make"):
        make().reset(options={"scene": "sine_box"})


def test_before_reset(make):
    env = make()
    with pytest.raises(error.ResetNeeded):
        env.step(np.int64(0))


@pytest.mark.parametrize(
    ("options", "choice"),
    [
        ({"scene": "four_boxes"}, "three_boxes"),
        ({"scene": "random:x"}, "random:SEED"),
        ({"scene": []}, "three_boxes"),
        ({"fidelity": "exact"}, "kinematic, lite, physics"),
        ({"preset": "worst"}, "paper"),
        ({"world": "flat"}, "typical"),
        ({"rewards": {"speed": 1.0}}, "coverage"),
        ({"rewards": {"view": -1.0}}, ">= 0"),
        ({"options": {"planning": {"epsilom": 1}}}, "epsilon"),
        ({"options": {"run": {"seed": 1}}}, "arguments of their own"),
        ({"ranges": {"color": (0, 1)}}, "albedo"),
        ({"goal": 0.0}, "goal"),
        ({"noise": (2.0, 1.0)}, "noise"),
    ],
)
def test_impossible_options_name_the_possible_ones(make, options, choice):
    with pytest.raises(ConfigError, match=choice):
        make(**options)


def test_unknown_names_are_unknown_names(make):
    with pytest.raises(UnknownNameError):
        make(scene=["three_boxes", "nowhere"])


def test_a_render_mode_that_is_none():
    with pytest.raises(error.UnsupportedMode, match="rgb_array"):
        OverlapEnv(render_mode="paper")


def test_scenes_are_drawn_from_a_list(make):
    env = make(scene=["three_boxes", "sine_box", "random:3"])
    names = {env.reset(seed=seed)[1]["scene"] for seed in range(12)}
    assert names == {"three_boxes", "sine_box", "random_3"}


def test_the_noise_of_random_scenes_varies(make):
    env = make(scene="random", noise=(0.5, 2.0), ranges={"shapes": ("box",), "walls": 1.0})
    scales = set()
    for seed in range(4):
        env.reset(seed=seed)
        scales.add(env.episode.source._robot._scanner.config.sigma)
    assert len(scales) == 4


def test_a_target_that_nobody_can_see_is_not_covered(make, tmp_path):
    walls = "".join(
        f'<geom type="box" pos="{x} {y} .4" size="{a} {b} .4"/>'
        for x, y, a, b in ((1, 0, 0.05, 0.8), (2.5, 0, 0.05, 0.8), (1.75, -0.8, 0.8, 0.05))
    )
    walls += '<geom type="box" pos="1.75 .8 .4" size=".8 .05 .4"/>'
    path = tmp_path / "shut.xml"
    path.write_text(
        f'<mujoco><worldbody><site name="spawn"/>{walls}'
        '<geom name="target" type="box" pos="1.75 0 .1" size=".1 .1 .1"/></worldbody></mujoco>'
    )
    _, info = make(scene=str(path)).reset(seed=0)
    assert info["coverage"] == 0.0


def test_pictures(make, capsys):
    env = make(render_mode="rgb_array")
    env.reset(seed=0)
    image = env.render()
    assert image.shape == (256, 256, 3)
    assert image.dtype == np.uint8
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 4
    other = make(render_mode="human")
    other.reset(seed=0)
    assert other.render() is None
    assert "\u2580" in capsys.readouterr().out


def test_episodes_that_are_over_leave_nothing_behind(make):
    env = make(scene="random")
    stages, casters, episodes = (weakref.WeakSet() for _ in range(3))
    for seed in range(14):
        env.reset(seed=seed)
        episodes.add(env.episode)
        stages.add(env.episode.prepared)
        casters.add(env.episode.prepared.caster)
    gc.collect()
    assert len(episodes) == 1
    assert len(stages) <= 5
    assert len(casters) <= 5


def test_a_scene_that_comes_again_is_loaded_once(make):
    one, two = make(), make()
    one.reset(seed=0)
    two.reset(seed=1)
    assert one.episode.prepared is two.episode.prepared
