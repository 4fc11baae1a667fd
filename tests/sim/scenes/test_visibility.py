"""What a lidar sees: the same by both casters, and in the truth."""

import mujoco
import numpy as np
import pytest

from scan3d_twin.core.errors import SceneError
from scan3d_twin.sim.embree import can_triangulate, is_available
from scan3d_twin.sim.ray_casting import EmbreeCaster, MujocoCaster
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene, scene_names
from scan3d_twin.sim.scenes.visibility import find_seen_geoms

TARGET = '<geom name="target" type="box" size=".2 .3 .3" pos="1 0 .3"/>'
MATERIALS = """<asset>
  <material name="solid" rgba=".6 .6 .6 1"/>
  <material name="void" rgba="1 1 1 0"/>
</asset>"""


def both_casters(model):
    """Return the casters that are there for ``model``."""
    casters = [MujocoCaster(model)]
    if is_available() and can_triangulate(model):
        casters.append(EmbreeCaster(model))
    return casters


def first_names(model, origin, direction):
    """Return the name of what each caster's ray hits first, and how far away."""
    found = []
    for caster in both_casters(model):
        hits = caster.cast(np.array(model.qpos0), np.array([origin]), np.array([direction]))
        geom = int(hits.geoms[0])
        found.append((model.geom(geom).name if geom >= 0 else None, float(hits.distances[0])))
    return found


def assert_first(model, name, distance, origin=(0.0, 0.01, 0.3), direction=(1.0, 0.0, 0.0)):
    """Assert what both casters' rays hit first."""
    for found, reach in first_names(model, np.array(origin), np.array(direction)):
        assert found == name
        assert reach == pytest.approx(distance, abs=1e-5)


@pytest.mark.parametrize("name", scene_names())
def test_all_of_a_built_in_scene_is_seen(name):
    assert find_seen_geoms(load_scene(name).model).all()


@pytest.mark.parametrize(
    ("size", "seen"), [(".01 .05 .05", True), (".2 .3 .2", False), (".2 .3 .05", True)]
)
def test_a_label_does_not_replace_the_box_that_it_is_on(scene_of, size, seen):
    """Only visual geoms that take up a quarter of a geom's bounding box stand for it."""
    scene = scene_of(
        '<body name="target" pos="1 0 .3"><geom name="box" type="box" size=".2 .3 .3"/>'
        f'<geom type="box" size="{size}" group="2" contype="0" conaffinity="0"/></body>'
    )
    assert find_seen_geoms(scene.model)[scene.model.geom("box").id] == seen
    assert ("box" in scene.target_geoms) == seen


@pytest.mark.parametrize(
    ("pane", "seen"),
    [
        ('material="solid"', True),
        ('material="void"', False),
        ('material="solid" rgba="1 1 1 0"', False),
        ('material="void" rgba="1 1 1 1"', True),
        ('rgba="1 1 1 0"', False),
    ],
)
def test_what_is_drawn_fully_transparent_is_not_there_for_light(scene_of, pane, seen):
    body = f'<geom name="pane" type="box" size=".02 .6 .6" pos=".5 0 .6" {pane}/>'
    model = scene_of(TARGET + body, MATERIALS).model
    assert_first(model, *(("pane", 0.48) if seen else ("target", 0.8)))


def test_planes_have_two_sides(scene_of):
    wall = '<geom name="wall" type="plane" size="1 1 .1" pos="{x} 0 .5" euler="0 {turn} 0"/>'
    floor = '<geom name="floor" type="plane" size="0 0 .1"/>'
    for turn in (90, -90):
        model = scene_of(TARGET + floor + wall.format(x=-2, turn=turn)).model
        assert_first(model, "wall", 2.0, direction=(-1.0, 0.0, 0.0))
        assert_first(model, None, np.inf, origin=(0.0, 1.01, 0.3), direction=(-1.0, 0.0, 0.0))


def test_endless_planes_do_not_end(scene_of):
    floors = '<geom name="floor" type="plane" size="0 {} .1"/>'
    down = np.array([1.0, 0.0, -0.001]) / np.hypot(1.0, 0.001)
    for width in (0, 5):
        model = scene_of(TARGET + floors.format(width)).model
        assert_first(model, "floor", 0.3 / down[2] * -1, (2.0, 0.0, 0.3), down)
        sideways = first_names(model, np.array([2.0, 6.0, 0.3]), np.array([0.0, 0.0, -1.0]))
        assert {name for name, _ in sideways} == {"floor" if width == 0 else None}


def test_something_below_the_far_part_of_a_floor_is_hidden(scene_of):
    block = '<geom name="deep" type="box" size="1 1 1" pos="300 0 -2"/>'
    floor = '<geom name="floor" type="plane" size="0 0 .1"/>'
    direction = np.array([298.0, 0.0, -2.3]) / np.hypot(298.0, 2.3)
    model = scene_of(TARGET + block + floor).model
    assert_first(model, "floor", 0.3 / -direction[2], (2.0, 0.0, 0.3), direction)


VISUAL = '<geom name="shown" type="box" size=".1 .3 .3" pos="1 0 .3" group="{}" {}/>'
CONTACT = '<geom name="contact" type="box" size=".3 .3 .3" pos="1 0 .3" group="{}"/>'
NO_CONTACT = 'contype="0" conaffinity="0"'


@pytest.mark.parametrize(
    ("visual_group", "contacts", "contact_group", "first"),
    [
        (2, NO_CONTACT, 3, "shown"),  # MuJoCo Menagerie
        (1, NO_CONTACT, 0, "shown"),  # robosuite, URDF imports
        (0, "", 3, "shown"),  # both touched, one drawn
        (0, NO_CONTACT, 0, "contact"),  # a label on a thing: both are drawn alike
        (4, NO_CONTACT, 3, "contact"),  # a marker nobody draws or touches
    ],
)
def test_visual_geoms_come_before_those_for_contacts(
    scene_of, visual_group, contacts, contact_group, first
):
    parts = VISUAL.format(visual_group, contacts) + CONTACT.format(contact_group)
    scene = scene_of(f'<body name="target">{parts}</body>')
    distance = 0.9 if first == "shown" else 0.7
    assert_first(scene.model, first, distance)
    if (visual_group, contact_group) != (0, 0):
        assert scene.targets == {"target": (first,)}


def test_what_only_contacts_show_is_seen(scene_of):
    scene = scene_of(f'<body name="target">{CONTACT.format(3)}</body>')
    assert_first(scene.model, "contact", 0.7)


@pytest.mark.parametrize(("place", "first"), [("1 0 .3", "shown"), ("1 3 .3", "contact")])
def test_in_the_world_body_only_what_is_near_stands_for_contacts(scene_of, place, first):
    visual = VISUAL.format(2, NO_CONTACT).replace("1 0 .3", place)
    target = '<geom name="target" size=".1" pos="5 5 .1"/>'
    scene = scene_of(target + visual + CONTACT.format(3))
    assert_first(scene.model, first, 0.9 if first == "shown" else 0.7)


def test_a_stand_in_named_as_target_means_what_it_stands_for(scene_of):
    parts = VISUAL.format(2, NO_CONTACT).replace('name="shown"', "")
    parts += CONTACT.format(3).replace("contact", "target_hull")
    scene = scene_of(f"<body>{parts}</body>")
    (names,) = scene.targets.values()
    assert names != ("target_hull",)
    assert scene.model.geom(names[0]).size == pytest.approx([0.1, 0.3, 0.3])


def test_a_target_nobody_can_see_is_refused(scene_of):
    with pytest.raises(SceneError, match="sees nothing of target 'target': it is fully transp"):
        scene_of(TARGET.replace("/>", ' rgba="1 0 0 0"/>'))


def test_the_truth_is_what_rays_see(tmp_path):
    parts = VISUAL.format(2, NO_CONTACT) + CONTACT.format(3)
    path = tmp_path / "parts.xml"
    path.write_text(
        "<mujoco><worldbody><site name='spawn' pos='-1 0 0'/>"
        f"<body name='target'>{parts}</body></worldbody></mujoco>"
    )
    with open_sim(str(path), 0) as (_, truth):
        points, normals = truth.surface(0.02)
        sides = np.abs(normals[:, 2]) < 0.5
        eyes = points[sides] + 0.5 * normals[sides]
        assert truth.first_hits(eyes, -normals[sides]) == pytest.approx(0.5, abs=1e-5)
        assert truth.locate("target") == pytest.approx((2.0, 0.0), abs=5e-3)


def test_rays_of_both_casters_agree_where_things_are_hidden(scene_of):
    if not is_available():
        pytest.skip("without Embree there is one caster")
    parts = VISUAL.format(2, NO_CONTACT) + CONTACT.format(3)
    wall = '<geom name="wall" type="plane" size="0 1 .1" pos="-2 0 .5" euler="0 -90 0"/>'
    ghosts = '<geom type="box" size=".02 .6 .6" pos=".5 0 .6" material="solid" rgba="1 1 1 0"/>'
    model = scene_of(f'<body name="target">{parts}</body>{wall}{ghosts}', MATERIALS).model
    rng = np.random.default_rng(4)
    directions = rng.standard_normal((50_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = rng.uniform([-5, -5, 0.01], [0.4, 5, 1], (50_000, 3))
    exact, fast = (caster.cast(np.empty(0), origins, directions) for caster in both_casters(model))
    assert np.mean(exact.geoms != fast.geoms) < 1e-4
    assert set(model.geom_type[exact.geoms[exact.geoms >= 0]].tolist()) >= {
        int(mujoco.mjtGeom.mjGEOM_PLANE),
        int(mujoco.mjtGeom.mjGEOM_BOX),
    }
