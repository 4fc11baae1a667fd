"""Random scenes: drawn within their ranges, the same for the same seed, and fit to be scanned."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from paper import paper_config

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.session_start import begin_session
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.random_ranges import SceneRanges, shape_names
from scan3d_twin.sim.scenes.random_scenes import draw_scene
from scan3d_twin.sim.scenes.random_shapes import build_shape
from scan3d_twin.sim.scenes.tessellation import mesh_triangles
from scan3d_twin.sim.world import RobotErrors, build_model


def generator(seed):
    """Return the generator of ``seed``."""
    return np.random.default_rng(seed)


def test_the_same_seed_gives_the_same_scene():
    one, two = load_scene("random:7"), load_scene("random:7")
    assert one.spec.to_xml() == two.spec.to_xml()
    assert one.name == "random_7"
    assert one.description.startswith("random: ")
    assert load_scene("random:8").spec.to_xml() != one.spec.to_xml()


def test_all_shapes_and_tours_come_up():
    scenes = [load_scene(f"random:{seed}") for seed in range(60)]
    shapes = Counter(scene.description.split(",")[0] for scene in scenes)
    assert len(shapes) == len(shape_names())
    assert {scene.tour for scene in scenes} == {"front", "full"}
    assert all((scene.front is None) == (scene.tour == "full") for scene in scenes)


@pytest.mark.parametrize("seed", range(20))
def test_the_robot_runs_finds_the_target_and_has_room(seed):
    scene = load_scene(f"random:{seed}")
    config = replace(
        paper_config(),
        tour=scene.tour,
        planning=replace(paper_config().planning, standoff=scene.standoff),
    )
    with open_sim(scene, seed) as (robot, truth):
        session, _ = begin_session(robot, config, seed, Unobserved(), None)
        surface, _ = truth.surface(0.05)
        assert not robot.base.hazards().active()
    found = scene.spawn.apply(session.hint)
    distance = np.linalg.norm(found[:, None] - surface[None, :, :2], axis=2).min(axis=1)
    assert np.mean(distance < 0.1) > 0.8


@pytest.mark.parametrize("shape", shape_names())
@pytest.mark.parametrize("seed", range(5))
def test_a_shape_keeps_to_its_ranges(shape, seed):
    ranges = SceneRanges(width=(0.5, 0.9), height=(0.4, 0.6), rise=(0.1, 0.15))
    solids = build_shape(shape, generator(seed), ranges)
    corners = np.concatenate([solid.corners() for solid in solids])
    low, high = corners.min(axis=0), corners.max(axis=0)
    assert low == pytest.approx(-high)  # the middle is at the origin
    assert np.ptp(corners[:, 1]) < 0.9 + 0.12
    assert all(solid.bottom == 0.0 for solid in solids)
    if shape != "steps":
        assert all(0.4 <= 2 * solid.size[2] <= 0.6 for solid in solids)


@pytest.mark.parametrize("seed", range(5))
def test_a_wavy_box_is_closed_and_faces_outwards(seed):
    model = draw_scene(generator(seed), SceneRanges(shapes=("sine",))).model
    geom = model.geom("target_0").id
    mesh = trimesh.Trimesh(**trimesh.triangles.to_kwargs(mesh_triangles(model, geom)))
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert mesh.volume > 0.2 * 0.35 * 0.3 * 0.5


def test_nothing_stands_in_the_robots_way_round_the_target():
    ranges = SceneRanges(clutter=(6, 6), tours=("full",))
    count = 0
    for seed in range(20):
        scene = draw_scene(generator(seed), ranges)
        model = scene.model
        target = max(np.hypot(*model.geom(name).pos[:2]) for name in scene.target_geoms)
        for k in range(model.ngeom):
            if model.geom(k).name.startswith("thing_"):
                x, y = model.geom(k).pos[:2]
                assert math.hypot(x, y) > target + scene.standoff + 0.17
                assert math.hypot(x - scene.spawn.x, y - scene.spawn.y) > 1.5
                count += 1
    assert count > 20


def test_materials_and_friction_are_drawn_within_bounds():
    ranges = SceneRanges(matte=0.0, dark=0.0, glossy=0.0, chrome=(0.4, 0.5), friction=(0.3, 0.3))
    scene = draw_scene(generator(0), ranges)
    material = scene.model.geom(scene.target_geoms[0]).matid[0]
    assert scene.model.mat_metallic[material] == 1.0
    assert 0.4 <= scene.model.mat_roughness[material] <= 0.5
    errors = RobotErrors(np.zeros(2), 0.0, 0.7, 0.0, np.zeros(2))
    robot = build_model(scene, "create2", errors)
    assert robot.geom("robot/left_tyre").friction[0] == pytest.approx(0.3)


@pytest.mark.parametrize("name", ["random:", "random:-1", "random:x", "random:1.5"])
def test_a_seed_that_is_none(name):
    with pytest.raises(ConfigError, match="random:SEED"):
        load_scene(name)


def test_ranges_that_cannot_be():
    with pytest.raises(ConfigError, match=r"random\.width must be"):
        SceneRanges(width=(1.0, 0.5))
    with pytest.raises(ConfigError, match=r"random\.albedo must be"):
        SceneRanges(albedo=(0.5, 1.5))
    with pytest.raises(ConfigError, match="<= 1"):
        SceneRanges(matte=0.9, dark=0.9)
    with pytest.raises(UnknownNameError, match="steps"):
        SceneRanges(shapes=("pyramid",))
    with pytest.raises(UnknownNameError, match="front"):
        SceneRanges(tours=("half",))
