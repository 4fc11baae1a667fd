import mujoco
import numpy as np
import pytest

from scan3d_twin.sim.ray_casting import (
    EmbreeCaster,
    MujocoCaster,
    choose_caster,
    choose_patient_caster,
)
from scan3d_twin.sim.scenes.load import load_scene, scene_names


def rays(rng, count):
    """Return origins and directions (n, 3) of random rays."""
    origins = rng.uniform([-1, -1, 0.1], [1, 1, 0.6], (count, 3))
    directions = rng.standard_normal((count, 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def distance_to(model, data, geom, origin, direction):
    """Return the distance of one geom along a ray, whatever else is there [m]; -1 for a miss."""
    return mujoco.mju_rayGeom(
        data.geom_xpos[geom],
        data.geom_xmat[geom],
        model.geom_size[geom],
        origin,
        direction,
        int(model.geom_type[geom]),
        None,
    )


@pytest.mark.parametrize("name", scene_names())
def test_rays_agree_with_mj_ray(name):
    scene = load_scene(name)
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    origins, directions = rays(np.random.default_rng(1), 300)
    hits = MujocoCaster(scene.model).cast(np.empty(0), origins, directions)
    geom = np.zeros(1, np.int32)
    for k in range(len(origins)):
        expected = mujoco.mj_ray(
            scene.model, data, origins[k], directions[k], None, 1, -1, geom, None
        )
        if hits.geoms[k] != geom[0]:  # coinciding faces: then it is a first hit as well
            assert distance_to(scene.model, data, hits.geoms[k], origins[k], directions[k]) == (
                pytest.approx(expected, abs=1e-5)
            )
        assert hits.distances[k] == (pytest.approx(expected) if geom[0] >= 0 else np.inf)


CURVED = [
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
    )
]


@pytest.mark.parametrize("name", scene_names())
def test_embree_and_mujoco_see_the_same(name):
    pytest.importorskip("embreex")
    model = load_scene(name).model
    origins, directions = rays(np.random.default_rng(2), 40_000)
    exact = MujocoCaster(model).cast(np.empty(0), origins, directions)
    fast = EmbreeCaster(model).cast(np.empty(0), origins, directions)
    assert (np.isfinite(exact.distances) != np.isfinite(fast.distances)).mean() < 1e-4
    same = (exact.geoms == fast.geoms) & (exact.geoms >= 0) & (exact.distances < 10)
    # A ray that starts within a chord's height of a surface may start on either side of it.
    same &= np.minimum(exact.distances, fast.distances) > 1e-3
    assert same.sum() > 0.99 * (exact.geoms >= 0).sum() - (exact.distances >= 10).sum()
    error = np.abs(np.where(same, exact.distances, 0) - np.where(same, fast.distances, 0))
    curved = np.isin(model.geom_type[exact.geoms], CURVED)
    assert error[same & ~curved].max() < 1e-5
    assert error[same & curved].max(initial=0.0) < 2e-4
    aslant = np.abs(np.einsum("ni,ni->n", exact.normals, directions)) > 0.05
    turned = np.linalg.norm(exact.normals - fast.normals, axis=1)[same & aslant]
    # Where two faces meet either normal is right.
    assert (turned > 1e-3).mean() < 1e-3


@pytest.mark.parametrize("name", ["steps", "corridor", "living_room", "ledge"])
def test_rays_from_within_touching_things_hit_the_same_geom(name):
    pytest.importorskip("embreex")
    model = load_scene(name).model
    rng = np.random.default_rng(3)
    boxes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inside = rng.choice(boxes, 20_000)
    local = rng.uniform(-1, 1, (len(inside), 3)) * model.geom_size[inside]
    turns = data.geom_xmat[inside].reshape(-1, 3, 3)
    origins = np.einsum("nij,nj->ni", turns, local) + data.geom_xpos[inside]
    directions = rays(rng, len(origins))[1]
    exact = MujocoCaster(model).cast(np.empty(0), origins, directions)
    fast = EmbreeCaster(model).cast(np.empty(0), origins, directions)
    assert (exact.geoms != fast.geoms).mean() <= 1e-4


COINCIDING = """
<geom name="wall" type="box" size=".5 2 1" pos="2.5 0 1"/>
<geom name="target" type="box" size=".2 .4 .4" pos="2.2 1 1"/>
<geom name="drum" type="cylinder" size=".3 .2" pos="0 0 .2"/>
<geom name="lid" type="cylinder" size=".3 .1" pos="0 0 .5"/>
"""


@pytest.mark.parametrize(
    ("origin", "direction", "geom", "normal"),
    [
        ((0, 1, 1), (1, 0, 0), "wall", (-1, 0, 0)),  # flush: the first of the file
        ((0.1, 0, 0.3), (0, 0, -1), "plane/0", (0, 0, 1)),  # planes first
        ((0.1, 0, 0.5), (0, 0, -1), "drum", (0, 0, 1)),
        ((0.1, 0, 0.3), (0, 0, 1), "drum", (0, 0, 1)),
        ((0.1, 0, 1.0), (0, 0, -1), "lid", (0, 0, 1)),
    ],
)
def test_where_faces_coincide_one_rule_names_the_geom(scene_of, origin, direction, geom, normal):
    pytest.importorskip("embreex")
    model = scene_of(COINCIDING + '<geom type="plane" size="9 9 .1"/>').model
    origins = np.array(origin) + np.random.default_rng(4).uniform(-0.05, 0.05, (200, 3))
    directions = np.tile(np.array(direction, float), (200, 1))
    for caster in (MujocoCaster(model), EmbreeCaster(model)):
        hits = caster.cast(np.empty(0), origins, directions)
        assert {model.geom(k).name for k in hits.geoms} == {geom}
        assert hits.normals == pytest.approx(np.tile(normal, (200, 1)), abs=1e-6)


def hilly(ball=""):
    """Return a model with a height field, a few things on it and a ``ball``."""
    spec = mujoco.MjSpec.from_string(
        f"""<mujoco><asset><hfield name="hills" nrow="9" ncol="7" size="2 3 .4 .2"/></asset>
        <worldbody><geom type="hfield" hfield="hills" pos=".1 .2 .3" euler="0 3 20"/>
        <geom type="box" size=".2 .3 .4" pos="1 0 .7"/>{ball}</worldbody></mujoco>"""
    )
    spec.hfield("hills").userdata = np.random.default_rng(5).random(63)
    return spec.compile()


def test_height_fields_are_seen_as_mujoco_sees_them(monkeypatch):
    pytest.importorskip("embreex")
    model = hilly()
    rng = np.random.default_rng(6)
    origins = rng.uniform([-3, -4, 0.9], [3, 4, 2], (20_000, 3))
    directions = rays(rng, len(origins))[1]
    casters = [MujocoCaster(model), EmbreeCaster(model)]
    monkeypatch.setattr("scan3d_twin.sim.ray_casting.is_available", lambda: False)
    expected = MujocoCaster(model).cast(np.empty(0), origins, directions)
    assert (expected.geoms == 0).sum() > 3000
    for caster in casters:
        hits = caster.cast(np.empty(0), origins, directions)
        assert (hits.geoms != expected.geoms).sum() <= 2
        same = (hits.geoms == expected.geoms) & (hits.geoms >= 0)
        error = np.abs(hits.distances[same] - expected.distances[same])
        assert (error < 1e-4).mean() > 0.9999
        aligned = np.abs(np.einsum("ni,ni->n", hits.normals, expected.normals))[same]
        assert (aligned > 0.999).mean() > 0.999


def test_many_rays_at_what_has_moved_are_cast_by_embree():
    pytest.importorskip("embreex")
    model = hilly(
        '<body pos="0 0 2"><freejoint/><geom size=".3"/></body>' + 8 * "<geom size='.01'/>"
    )
    patient = choose_patient_caster(model)
    assert not isinstance(patient, MujocoCaster)
    origins, directions = rays(np.random.default_rng(7), 5000)
    origins[:, 2] += 2
    for place in (0.0, 0.8):
        qpos = np.array([place, 0.3, 1.9, 1, 0, 0, 0])
        expected = MujocoCaster(model).cast(qpos, origins, directions)
        hits = patient.cast(qpos, origins, directions)
        ball = expected.geoms == model.ngeom - 1
        assert ball.sum() > 50
        assert (hits.geoms == expected.geoms).mean() > 0.999
        assert hits.distances[ball] == pytest.approx(expected.distances[ball], abs=2e-4)


def test_embree_is_chosen_for_crowds_and_large_meshes_that_stand_still(scene_of):
    pytest.importorskip("embreex")
    chosen = {name: choose_caster(load_scene(name).model) for name in scene_names()}
    assert isinstance(chosen["clutter_100"], EmbreeCaster)
    assert isinstance(chosen["sine_box"], EmbreeCaster)
    assert isinstance(chosen["plain_wall"], MujocoCaster)
    crowd = "".join(f'<geom size=".1" pos="{x} 3 .1"/>' for x in range(20))
    ball = '<body pos="2 0 1"><freejoint/><geom size=".1"/></body>'
    target = '<geom name="target" size=".1" pos="9 0 .1"/>'
    assert isinstance(choose_caster(scene_of(crowd + target).model), EmbreeCaster)
    assert isinstance(choose_caster(scene_of(crowd + ball + target).model), MujocoCaster)


def test_without_embree_mujoco_casts_all(monkeypatch):
    monkeypatch.setattr("scan3d_twin.sim.ray_casting.is_available", lambda: False)
    assert isinstance(choose_caster(load_scene("clutter_100").model), MujocoCaster)


def test_rays_pass_through_what_is_transparent_in_both(scene_of):
    pytest.importorskip("embreex")
    body = '<geom type="box" size=".1 1 1" pos="1 0 1" rgba="0 0 0 0"/>'
    model = scene_of(body + '<geom name="target" type="box" size=".1 1 1" pos="3 0 1"/>').model
    origin, ahead = np.array([[0.0, 0.2, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    for caster in (MujocoCaster(model), EmbreeCaster(model)):
        assert caster.cast(np.empty(0), origin, ahead).distances == pytest.approx([2.9])


def test_normals_of_a_cylinder_are_exact():
    scene = load_scene("shiny_cylinder")
    origins = np.array([[-1.0, 0.07, 0.3], [-1.0, -0.14, 0.2]])
    directions = np.tile([1.0, 0.0, 0.0], (2, 1))
    hits = MujocoCaster(scene.model).cast(np.empty(0), origins, directions)
    points = origins + hits.distances[:, None] * directions
    expected = points * (1, 1, 0) / 0.15
    assert hits.normals == pytest.approx(expected, abs=1e-9)


def test_a_miss_is_infinite():
    scene = load_scene("plain_wall")
    hits = MujocoCaster(scene.model).cast(
        np.empty(0), np.array([[0.0, 0.0, 1.0]]), np.array([[-1.0, 0.0, 0.0]])
    )
    assert hits.distances[0] == np.inf
    assert hits.geoms[0] == -1


def test_moving_objects_are_where_they_are_now(scene_of):
    ball = '<body pos="2 0 1"><freejoint/><geom size=".1"/></body>'
    scene = scene_of(ball + '<geom name="target" size=".1" pos="9 0 0"/>')
    caster = MujocoCaster(scene.model)
    origin, ahead = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 0.0]])
    near = caster.cast(np.array([1.0, 0, 1, 1, 0, 0, 0]), origin, ahead)
    gone = caster.cast(np.array([1.0, 5, 1, 1, 0, 0, 0]), origin, ahead)
    assert near.distances == pytest.approx([0.9])
    assert gone.distances[0] == np.inf
