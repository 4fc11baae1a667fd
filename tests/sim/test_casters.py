import mujoco
import numpy as np
import pytest

from scan3d_twin.sim.casters import MujocoCaster
from scan3d_twin.sim.scene import load_scene, scene_names


def rays(rng, count):
    origins = rng.uniform([-1, -1, 0.1], [1, 1, 0.6], (count, 3))
    directions = rng.standard_normal((count, 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


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
        assert hits.geoms[k] == geom[0]
        assert hits.distances[k] == (pytest.approx(expected) if geom[0] >= 0 else np.inf)


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
