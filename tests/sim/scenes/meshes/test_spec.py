import numpy as np
import pytest
import trimesh

from scan3d_twin.core.errors import ConfigError, HazardError, SceneError
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import choose_caster
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.truth import Truth


def cup(radius=0.15, height=0.3, wall=0.01):
    """An open cup: its convex hull is closed."""
    outer = trimesh.creation.annulus(radius - wall, radius, height)
    bottom = trimesh.creation.cylinder(radius, wall)
    bottom.apply_translation([0, 0, -height / 2])
    return trimesh.util.concatenate([outer, bottom])


@pytest.fixture
def save(tmp_path):
    """Save a mesh as a file."""

    def write(mesh, name="thing.stl"):
        """Write ``mesh`` and return its path."""
        path = tmp_path / name
        mesh.export(path)
        return str(path)

    return write


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_mesh_stands_on_the_floor_ahead_of_the_robot(save, suffix):
    path = save(
        trimesh.creation.box((0.3, 0.4, 0.5), transform=np.diag([1, 1, 1, 1.0])), f"b.{suffix}"
    )
    with open_sim(path, 0) as (_, truth):
        points, _ = truth.surface(0.02)
        assert points[:, 2].min() >= 0.0
        assert points[:, 2].max() == pytest.approx(0.5, abs=1e-6)
        assert truth.locate("target") == pytest.approx((1.65, 0.0), abs=2e-3)
        hit = truth.first_hits(np.array([[-1.0, 0.0, 0.2]]), np.array([[1.0, 0.0, 0.0]]))
        assert hit == pytest.approx([0.85], abs=1e-6)


def test_glb_has_its_y_axis_up(save):
    path = save(trimesh.creation.box((0.3, 0.5, 0.4)), "b.glb")
    with open_sim(path, 0) as (_, truth):
        assert truth.surface(0.02)[0].max(axis=0) == pytest.approx([0.15, 0.2, 0.5], abs=1e-6)


def test_the_scale_is_metres_per_unit(save):
    scene = load_scene(save(trimesh.creation.box((300, 400, 500))), 0.001)
    with open_sim(scene, 0) as (_, truth):
        assert truth.surface(0.02)[0][:, 2].max() == pytest.approx(0.5, abs=1e-6)


def test_a_size_that_cannot_be_meant_names_the_option(save):
    with pytest.raises(SceneError, match=r"thing\.stl would be 500 m large; give --mesh-scale"):
        load_scene(save(trimesh.creation.box((300, 400, 500))))


def test_rays_see_the_true_triangles(save):
    with open_sim(save(cup()), 0) as (_, truth):
        down = np.array([[0.0, 0.0, -1.0]])
        into = truth.first_hits(np.array([[0.011, 0.007, 1.0]]), down)
        rim = truth.first_hits(np.array([[0.145, 0.003, 1.0]]), down)
        assert rim == pytest.approx([0.695], abs=0.002)
        assert into == pytest.approx([0.99], abs=0.002)


def test_a_hollow_mesh_does_not_swallow_the_robot(save):
    walls = trimesh.creation.box((4.0, 4.0, 0.5))
    inner = trimesh.creation.box((3.8, 3.8, 0.6))
    faces = np.vstack([walls.faces, inner.faces[:, ::-1] + len(walls.vertices)])
    room = trimesh.Trimesh(np.vstack([walls.vertices, inner.vertices]), faces, process=False)
    room.update_faces(np.abs(room.face_normals[:, 2]) < 0.5)
    scene = load_scene(save(room))
    boxes = [geom for geom in scene.spec.geoms if geom.name == ""]
    assert len(boxes) > 4
    for geom in boxes:
        inside = (np.abs(np.array(geom.pos[:2])) + geom.size[:2] < 1.5).all()
        covers_middle = (np.abs(np.array(geom.pos[:2])) < geom.size[:2]).all()
        assert not inside
        assert not covers_middle


def test_the_robot_bumps_into_a_mesh_and_rays_ignore_its_collision_boxes(save):
    with open_sim(save(trimesh.creation.icosphere(3, 0.3)), 0) as (robot, truth):
        hit = truth.first_hits(np.array([[-1.0, 0.01, 0.31]]), np.array([[1.0, 0.0, 0.0]]))
        assert hit == pytest.approx([0.7], abs=0.003)
        robot.base.set_velocity(0.3, 0.0)
        with pytest.raises(HazardError, match="bump"):
            robot.clock.sleep(10.0)
        assert truth.pose_at(robot.clock.now()).x < -0.165


def test_an_open_sheet_will_do(save):
    sheet = trimesh.Trimesh([[0, -1, 0], [0, 1, 0], [0, 1, 1], [0, -1, 1]], [[0, 1, 2], [0, 2, 3]])
    with open_sim(save(sheet), 0) as (_, truth):
        hit = truth.first_hits(np.array([[-1.0, 0.01, 0.31]]), np.array([[1.0, 0.0, 0.0]]))
        assert hit == pytest.approx([1.0], abs=1e-6)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb"])
@pytest.mark.parametrize("content", [b"", b"this is not a mesh at all\n" * 9])
def test_what_is_not_a_mesh_is_one_line_with_the_file_name(tmp_path, suffix, content):
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=rf"bad\.{suffix}") as caught:
        load_scene(str(path))
    assert "\n" not in str(caught.value)


def test_triangles_without_area_are_no_mesh(tmp_path):
    path = tmp_path / "line.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(SceneError, match=r"line\.obj holds no triangles"):
        load_scene(str(path))


def test_points_without_triangles_are_no_mesh(tmp_path):
    path = tmp_path / "cloud.ply"
    trimesh.PointCloud(np.eye(3)).export(path)
    with pytest.raises(SceneError, match=r"cloud\.ply"):
        load_scene(str(path))


def wall_distances(scene):
    """Return how far the walls are from the middle of the mesh [m]: ahead, behind, left, right."""
    truth = Truth(scene, KinematicWorld(scene.spawn), choose_caster(scene.model), lambda: None)
    above = float(truth.surface(0.02)[0][:, 2].max()) + 0.1
    ways = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=float)
    return truth.first_hits(np.tile([0.0, 0.0, above], (4, 1)), ways)


def test_a_mesh_stands_in_the_middle_of_a_room(save):
    path = save(trimesh.creation.box((0.3, 0.4, 0.5)))
    assert wall_distances(load_scene(path)) == pytest.approx([2.5] * 4, abs=1e-5)
    wide = wall_distances(load_scene(path, room="6x4.5"))
    assert wide == pytest.approx([2.25, 2.25, 3.0, 3.0], abs=1e-5)


def test_the_room_grows_with_the_mesh(save):
    scene = load_scene(save(trimesh.creation.box((2.0, 4.0, 0.5))))
    ahead, behind, left, right = wall_distances(scene)
    assert ahead == pytest.approx(behind)
    assert behind + scene.spawn.x >= 0.35  # the robot's radius, twice
    assert left == pytest.approx(right)
    assert right - 2.0 == pytest.approx(behind - 1.0)
    size = "2.00 x 4.00 x 0.50 m high"
    assert (
        scene.description == f"mesh thing.stl, {size}, in a room of {2 * left:g} x {2 * behind:g} m"
    )


def test_a_mesh_may_stand_on_an_open_floor(save):
    scene = load_scene(save(trimesh.creation.box((0.3, 0.4, 0.5))), room="none")
    assert np.isinf(wall_distances(scene)).all()
    assert scene.description == "mesh thing.stl, 0.30 x 0.40 x 0.50 m high, on an open floor"


@pytest.mark.parametrize("room", ["", "5", "5x", "5x5x5", "0.5x5", "5x500", "nanx5", "big"])
def test_a_room_is_two_sizes_or_none(save, room):
    with pytest.raises(ConfigError, match=r"room must be WIDTHxDEPTH .* got"):
        load_scene(save(trimesh.creation.box((0.3, 0.4, 0.5))), room=room)
