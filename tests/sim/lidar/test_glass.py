"""Transparent things: a return of the pane, of what is behind it, or none, by optics and angle."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from scan3d_twin.devices.urg.device import URG04LX
from scan3d_twin.sim.embree import is_available
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.footprint import mix
from scan3d_twin.sim.lidar.glass import REFRACTIVE_INDEX, Panes, transmittance
from scan3d_twin.sim.lidar.optics import Materials
from scan3d_twin.sim.ray_casting import EmbreeCaster, MujocoCaster
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene, scene_names
from scan3d_twin.sim.truth import Truth

CONFIG = replace(LidarModelConfig(), sub_rays=1)
PULSES = replace(URG04LX.sensor, modulations=None)
TARGET = '<geom name="target" type="box" size=".1 3 1" pos="2.1 0 1"/>'
GLASS = 'rgba="1 1 1 .2"'
PANES = {
    "box": f'<geom type="box" size=".003 2 1" pos="1 0 1" {GLASS}/>',
    "plane": f'<geom type="plane" size="1 2 .1" pos="1 0 1" euler="0 -90 0" {GLASS}/>',
    "back of a plane": f'<geom type="plane" size="1 2 .1" pos="1 0 1" euler="0 90 0" {GLASS}/>',
    "closed mesh": f'<geom type="mesh" mesh="plate" pos="1 0 1" {GLASS}/>',
    "open mesh": '<geom type="mesh" mesh="sheet" pos="1 0 1" contype="0" conaffinity="0" '
    f"{GLASS}/>",
}


@pytest.fixture
def assets(tmp_path):
    """Write the meshes of panes and return the head of a scene that has them."""
    plate = trimesh.creation.box((0.006, 4, 2))
    plate.invert()  # which side is out is not up to the winding
    plate.export(tmp_path / "plate.stl")
    corners = [[0, -2, -1], [0, 2, -1], [0, 2, 1], [0, -2, 1]]
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]).export(tmp_path / "sheet.stl")
    return (
        f'<compiler meshdir="{tmp_path}"/><asset><mesh file="plate.stl" inertia="shell"/>'
        '<mesh file="sheet.stl" inertia="shell"/></asset>'
    )


def casters(model):
    """Return all casters of ``model``."""
    return [MujocoCaster(model), *([EmbreeCaster(model)] if is_available() else [])]


def look(model, caster, degrees, sensor=URG04LX.sensor, config=CONFIG):
    """Return the strongest hit and the light of one ray in the plane z = 1 through the origin."""
    angle = np.radians(degrees)
    rays = np.array([[0.0, 0.0, 1.0]]), np.array([[np.cos(angle), np.sin(angle), 0.0]])
    hits = caster.cast(np.empty(0), *rays)
    materials = Materials.of(model, config)
    cosines = np.abs(np.einsum("ni,ni->n", hits.normals, rays[1]))
    power = materials.power(hits.geoms, cosines, hits.distances)
    mixed = mix(hits.distances[None], power[None], config, sensor)
    panes = Panes.of(model, caster)
    optics = config, sensor
    return panes.look_through(np.empty(0), rays, hits, cosines, materials, 1, optics, mixed)


@pytest.mark.parametrize("name", scene_names())
def test_built_in_scenes_have_no_panes(name):
    model = load_scene(name).model
    assert Panes.of(model, MujocoCaster(model)) is None


def test_a_pane_lets_through_what_the_text_book_says():
    n = REFRACTIVE_INDEX
    assert transmittance(np.array([1.0])) == pytest.approx(2 * n / (n**2 + 1))
    angles = np.radians(np.linspace(0, 90, 50))
    shares = transmittance(np.cos(angles))
    assert (np.diff(shares) < 0).all()
    assert shares[-1] == pytest.approx(0.0, abs=1e-9)
    # At Brewster's angle p is not reflected at all, and s by ((n^2 - 1) / (n^2 + 1))^2.
    s = ((n**2 - 1) / (n**2 + 1)) ** 2
    brewster = transmittance(np.cos(np.arctan([n])))
    assert brewster == pytest.approx((1 + (1 - s) / (1 + s)) / 2)


@pytest.mark.parametrize("pane", PANES)
def test_behind_a_pane_the_light_passes_it_twice(scene_of, assets, pane):
    model = scene_of(TARGET + PANES[pane], assets).model
    clear = scene_of(TARGET, assets).model
    for caster in casters(model):
        for degrees in (25, 50):
            hits, cosines, light = look(model, caster, degrees, PULSES)
            cosine = np.cos(np.radians(degrees))
            bare = Materials.of(clear, CONFIG).power(np.array([0]), cosines, hits.distances)
            share = 0.8 * transmittance(np.array([cosine]))
            assert model.geom(int(hits.geoms[0])).name == "target"
            assert hits.distances == pytest.approx([2 / cosine], abs=1e-4)
            assert light.power == pytest.approx(bare * share**2, rel=1e-4)


@pytest.mark.parametrize("pane", PANES)
def test_near_its_normal_a_pane_returns_light_itself(scene_of, assets, pane):
    model = scene_of(TARGET + PANES[pane], assets).model
    for caster in casters(model):
        hits, _, light = look(model, caster, 1.0)
        assert hits.distances == pytest.approx([1.0], abs=0.004)
        assert light.distances == pytest.approx([1.0], abs=0.02)
        assert light.power > 1.0


def test_nothing_returns_from_behind_at_grazing_incidence(scene_of):
    wide = '<geom name="target" type="box" size=".1 90 1" pos="2.1 0 1"/>'
    pane = PANES["box"].replace(".003 2 1", ".003 90 1")
    model = scene_of(wide + pane).model
    for caster in casters(model):
        _, _, light = look(model, caster, 84.0)
        assert light.power < CONFIG.threshold / 2
        assert (look(scene_of(wide + PANES["box"]).model, caster, 20.0)[2].power > 0.01).all()


def test_several_panes_take_their_share_each(scene_of):
    two = PANES["box"] + PANES["box"].replace('pos="1 ', 'pos="1.3 ')
    share = 0.8 * transmittance(np.cos(np.radians([30.0])))
    model, other = scene_of(TARGET + PANES["box"]).model, scene_of(TARGET + two).model
    one = look(model, MujocoCaster(model), 30, PULSES)[2].power
    both = look(other, MujocoCaster(other), 30, PULSES)[2].power
    assert both == pytest.approx(one * share**2, rel=1e-6)


def test_phases_add_and_pulses_do_not(scene_of):
    dirty = PANES["box"].replace(".2", ".5")
    model = scene_of(TARGET + dirty).model
    caster = MujocoCaster(model)
    truth = 2 / np.cos(np.radians(12))
    by_phase = look(model, caster, 12)[2].distances
    by_pulse = look(model, caster, 12, PULSES)[2].distances
    assert truth / 2 + 0.02 < by_phase < truth - 0.02
    assert min(abs(by_pulse - truth), abs(by_pulse - truth / 2)) < 0.01


def test_pulses_agree_over_the_footprint(scene_of):
    model = scene_of(TARGET + PANES["box"].replace(".2", ".6")).model
    caster, config = MujocoCaster(model), replace(CONFIG, sub_rays=5)
    angles = np.radians([7.0, 7.1, 7.2, 6.9, 6.8])
    directions = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    rays = np.tile([0.0, 0.0, 1.0], (5, 1)), directions
    hits = caster.cast(np.empty(0), *rays)
    none = mix(np.full((5, 1), np.inf), np.zeros((5, 1)), config, PULSES)
    panes, materials = Panes.of(model, caster), Materials.of(model, config)
    cosines, optics = np.abs(np.einsum("ni,ni->n", hits.normals, directions)), (config, PULSES)
    _, _, light = panes.look_through(np.empty(0), rays, hits, cosines, materials, 1, optics, none)
    near = min(abs(light.distances[0] - 1 / np.cos(0.122)), abs(light.distances[0] - 2.015))
    assert near < 0.02


def test_alpha_goes_from_clear_to_opaque(scene_of):
    """Nearly opaque things stay walls, nearly clear ones are hardly there."""
    found = []
    for alpha in (0.05, 0.25, 0.9, 0.99):
        pane = PANES["box"].replace("1 1 1 .2", f"1 1 1 {alpha}")
        model = scene_of(TARGET + pane).model
        hits, _, light = look(model, MujocoCaster(model), 30)
        found.append((model.geom(int(hits.geoms[0])).name, float(light.power[0])))
    assert [name for name, _ in found] == ["target", "target", "", ""]
    solid = scene_of(TARGET + PANES["box"].replace("1 1 1 .2", "1 1 1 1")).model
    wall = Materials.of(solid, CONFIG).power(
        np.array([1]), np.cos(np.radians([30.0])), np.array([1 / np.cos(np.radians(30))])
    )
    assert found[-1][1] == pytest.approx(wall[0], rel=0.15)


def test_the_truth_sees_through_panes_but_robots_do_not_pass_them(scene_of):
    scene = scene_of(TARGET + PANES["box"])
    truth = Truth(scene, KinematicWorld(scene.spawn), MujocoCaster(scene.model), lambda: None)
    rays = np.array([[0.0, 0.0, 0.5]] * 2), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert truth.first_hits(*rays) == pytest.approx([0.997, np.inf])
    assert truth.first_opaque_hits(*rays) == pytest.approx([2.0, np.inf])


def test_a_scan_through_a_pane_shows_what_is_behind(tmp_path):
    path = tmp_path / "glass.xml"
    path.write_text(
        '<mujoco><worldbody><site name="spawn" pos="-1.5 0 0"/>'
        '<geom name="target" type="box" size=".3 .6 .6" pos=".3 0 .6"/>'
        '<geom name="pane" type="box" size=".003 1 .6" pos="-.5 0 .6" rgba=".8 .9 1 .25"/>'
        "</worldbody></mujoco>"
    )
    with open_sim(str(path), 0) as (robot, truth):
        line = robot.lidar.read_line(1.0)
        found = truth.evidence()
    model = load_scene(str(path)).model
    elevations = np.degrees(robot.lidar.spec.elevations)
    at_target = found.geoms == model.geom("target").id
    oblique = (np.abs(elevations) > 8) & at_target
    assert oblique.sum() > 30
    assert np.isfinite(line.ranges[oblique]).mean() > 0.9
    error = np.abs(line.ranges[oblique] - found.distances[oblique])
    assert np.nanmedian(error) < 0.02
    facing = np.abs(elevations) < 1
    assert (found.geoms[facing] == model.geom("pane").id).all()
    assert int(model.geom_type[found.geoms[facing][0]]) == mujoco.mjtGeom.mjGEOM_BOX
