"""The faces of meshes: what can be seen of them does not depend on their winding."""

import numpy as np
import pytest
import trimesh

from scan3d_twin.core.config import Config
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import EMBREE_MANY_TRIANGLES, choose_caster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.orientation import find_patches, weld
from scan3d_twin.sim.truth import Truth


def standing(mesh):
    """Return ``mesh`` turned a little, so that nothing is aligned with the axes of the room."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    return mesh


def open_box():
    """A box of sheets without a lid."""
    box = trimesh.creation.box((0.5, 0.4, 0.3))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    return standing(box)


def cup():
    """A cup with thick walls, of two solids."""
    outer = trimesh.creation.annulus(0.2, 0.25, 0.5)
    bottom = trimesh.creation.cylinder(0.24, 0.02)
    bottom.apply_translation([0, 0, -0.24])
    return trimesh.util.concatenate([outer, bottom])


def soup():
    """A torus whose triangles share no vertices."""
    ring = trimesh.creation.torus(0.3, 0.1, major_sections=16, minor_sections=8)
    points = ring.triangles.reshape(-1, 3)
    return trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)


def cracked():
    """A box whose sides do not share their corners exactly."""
    box = trimesh.creation.box((0.5, 0.4, 0.3))
    triangles = box.triangles + 2e-4 * box.face_normals[:, None]
    points = triangles.reshape(-1, 3)
    return standing(trimesh.Trimesh(points, np.arange(36).reshape(-1, 3), process=False))


def punctured():
    """A ball with a hole of one triangle."""
    ball = trimesh.creation.icosphere(2, 0.3)
    ball.update_faces(np.arange(len(ball.faces)) != 40)
    return ball


def doubled():
    """A sheet with every triangle twice, once for each side."""
    sheet = screen()
    faces = np.vstack([sheet.faces, sheet.faces[:, ::-1]])
    return trimesh.Trimesh(sheet.vertices, faces, process=False)


def screen():
    """A sheet that stands upright."""
    corners = [[0, -0.4, 0], [0, 0.4, 0], [0, 0.4, 0.6], [0, -0.4, 0.6]]
    return standing(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]))


def table():
    """A table: its underside is seen past its legs."""
    parts = [trimesh.creation.box((0.8, 0.8, 0.04))]
    parts[0].apply_translation([0, 0, 0.6])
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        leg = trimesh.creation.box((0.05, 0.05, 0.6))
        leg.apply_translation([0.35 * x, 0.35 * y, 0.3])
        parts.append(leg)
    return standing(trimesh.util.concatenate(parts))


def area_off_floor(mesh):
    """Return the area of ``mesh`` but for what lies on the floor [m2]."""
    down = (mesh.face_normals[:, 2] < -0.9) & (
        mesh.triangles_center[:, 2] < mesh.bounds[0, 2] + 0.002
    )
    return float(mesh.area_faces[~down].sum())


SHAPES = (open_box, cup, soup, cracked, punctured, doubled, screen, table)


def wind(mesh, chosen, way=(0, 2, 1)):
    """Return ``mesh`` with the ``chosen`` faces wound the other way, their corners listed so."""
    faces = np.where(np.asarray(chosen)[:, None], mesh.faces[:, way], mesh.faces)
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


@pytest.fixture
def measure(tmp_path):
    """Measure what can be seen of a mesh."""

    def load(mesh):
        """Return the scene of ``mesh``, the share of its surface that can be seen, and its area."""
        path = tmp_path / "thing.stl"
        mesh.export(path)
        scene = load_scene(str(path))
        truth = Truth(scene, KinematicWorld(scene.spawn), choose_caster(scene.model), lambda: None)
        points, normals = truth.surface(0.02)
        seen = find_coverable_surface(points, normals, truth, Config(tour="full"))
        return scene, float(seen.mean()), len(points) * 0.02**2

    return load


@pytest.mark.parametrize("shape", SHAPES)
def test_what_can_be_seen_does_not_depend_on_the_winding(measure, shape):
    mesh = shape()
    rng = np.random.default_rng(5)
    _, right, area = measure(mesh)
    for share in (1.0, 0.4):
        _, other, same = measure(wind(mesh, rng.random(len(mesh.faces)) < share))
        assert other == pytest.approx(right, abs=0.01)
        assert same == pytest.approx(area, rel=0.01)


def test_large_meshes_are_turned_outwards_too(tmp_path):
    """Their rays are cast by Embree, where it is installed."""
    ball = trimesh.creation.icosphere(5, 0.3)
    chosen = np.random.default_rng(8).random(len(ball.faces)) < 0.4
    wind(ball, chosen).export(tmp_path / "ball.ply")
    facing = load_scene(str(tmp_path / "ball.ply")).facings["target"]
    assert len(ball.faces) >= EMBREE_MANY_TRIANGLES
    assert (facing.flipped == chosen).all()
    assert not facing.two_sided.any()


@pytest.mark.parametrize("suffix", ["stl", "obj"])
@pytest.mark.parametrize("way", [(0, 2, 1), (2, 1, 0), (1, 0, 2)])
def test_samples_do_not_depend_on_the_winding(tmp_path, suffix, way):
    """A small object has few samples: another one is 2 % of what can be seen of it."""
    wedge = standing(trimesh.creation.cone(0.06, 0.1, sections=5))
    wedge = trimesh.util.concatenate([wedge, screen().apply_scale(0.2)])
    rng = np.random.default_rng(7)
    found = []
    for share in (0.0, 1.0, 0.4):
        path = tmp_path / f"thing.{suffix}"
        wind(wedge, rng.random(len(wedge.faces)) < share, way).export(path)
        scene = load_scene(str(path))
        truth = Truth(scene, KinematicWorld(scene.spawn), choose_caster(scene.model), lambda: None)
        found.append(truth.surface(0.03))
    for points, normals in found[1:]:
        assert points == pytest.approx(found[0][0], abs=1e-7)
        assert normals == pytest.approx(found[0][1], abs=1e-5)


@pytest.mark.parametrize("shape", [cup, soup, cracked, punctured, table])
def test_closed_things_are_left_as_they_are(measure, shape):
    scene, _, area = measure(shape())
    assert scene.notes == ()
    assert area == pytest.approx(area_off_floor(shape()), rel=0.03)  # round ones touch the floor


@pytest.mark.parametrize("shape", [open_box, screen])
def test_sheets_have_two_sides(measure, shape):
    scene, share, area = measure(shape())
    assert area == pytest.approx(shape().area + area_off_floor(shape()), rel=0.01)
    assert share > (0.9 if shape is screen else 0.4)
    assert "part of an open sheet and count on both sides" in scene.notes[0]


def test_repeated_faces_count_once(measure):
    scene, _, area = measure(doubled())
    assert area == pytest.approx(2 * screen().area, rel=0.01)
    assert "2 of 4 faces are repeated and count once" in scene.notes[0]


def test_what_was_turned_is_said(measure):
    box = standing(trimesh.creation.box((0.5, 0.4, 0.3)))
    scene, share, _ = measure(wind(box, np.arange(12) < 4))
    assert scene.notes == ("Mesh target: 4 of 12 faces are wound inwards and were turned.",)
    assert share > 0.5


def test_the_inside_of_a_room_is_what_the_robot_sees(tmp_path):
    room = trimesh.creation.box((4, 4, 2))
    shell = trimesh.creation.box((4.2, 4.2, 2.2))
    faces = np.vstack([room.faces[:, ::-1], shell.faces + 8])
    walls = trimesh.Trimesh(np.vstack([room.vertices, shell.vertices]), faces, process=False)
    for share in (0.0, 0.4, 1.0):
        chosen = np.random.default_rng(6).random(len(faces)) < share
        wind(walls, chosen).export(tmp_path / "room.stl")
        (tmp_path / "room.xml").write_text(
            '<mujoco><asset><mesh name="room" file="room.stl" inertia="shell"/></asset><worldbody>'
            '<site name="spawn"/><geom name="target" type="mesh" mesh="room" pos="0 0 1"'
            ' contype="0" conaffinity="0"/></worldbody></mujoco>'
        )
        scene = load_scene(str(tmp_path / "room.xml"))
        truth = Truth(scene, KinematicWorld(scene.spawn), choose_caster(scene.model), lambda: None)
        points, normals = truth.surface(0.1)
        inner = (np.abs(points[:, :2]).max(axis=1) < 2.05) & (np.abs(normals[:, 2]) < 0.5)
        towards = np.einsum("ni,ni->n", points[inner, :2], normals[inner, :2])
        assert inner.sum() > 1000
        assert (towards < 0).all()


def test_patches_end_where_more_than_two_faces_meet():
    corners = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0.5, 0], [-1, -0.5, 0]], float)
    fins = corners[[[0, 1, 2], [0, 1, 3], [0, 1, 4]]]
    patches, reversed_, closed = find_patches(weld(fins), np.zeros(3, bool))
    assert len(set(patches.tolist())) == 3
    assert not reversed_.any()
    assert not closed.any()


def test_a_band_with_one_side_is_not_closed():
    angle = np.linspace(0, 2 * np.pi, 21)[:-1]
    middle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    wide = 0.3 * np.stack(
        [np.cos(angle) * np.cos(angle / 2), np.sin(angle) * np.cos(angle / 2), np.sin(angle / 2)],
        axis=1,
    )
    left, right = middle + wide, middle - wide
    after = (np.roll(left, -1, axis=0), np.roll(right, -1, axis=0))
    after[0][-1], after[1][-1] = right[0], left[0]
    band = np.concatenate(
        [np.stack([left, right, after[1]], axis=1), np.stack([left, after[1], after[0]], axis=1)]
    )
    patches, _, closed = find_patches(weld(band), np.zeros(len(band), bool))
    assert set(patches.tolist()) == {0}
    assert not closed.any()
