import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import numpy as np
import pytest
import trimesh

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.model.fused_cloud import Model, build_model, build_view_clouds
from scan3d_twin.core.model.mesh import Mesh, build_mesh
from scan3d_twin.recording import export
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export import find_format, find_mesh_format, list_mesh_formats
from scan3d_twin.recording.export.format import CloudFormat, MeshFormat
from scan3d_twin.recording.export.meshes import (
    MAX_POISSON_DISTANCE,
    reconstruct_poisson,
)


@pytest.fixture(scope="module")
def mesh(session) -> Mesh:
    """The mesh of the session."""
    return build_mesh(session, build_view_clouds(session))


@pytest.mark.parametrize("name", ["glb", "obj", "ply", "stl"])
def test_trimesh_reads_the_same_surface(name, mesh, tmp_path):
    path = tmp_path / f"mesh.{name}"
    path.write_bytes(find_mesh_format(name).encode(mesh))
    again = trimesh.load(path, force="mesh", process=False)
    assert len(again.faces) == len(mesh.faces)
    assert again.area == pytest.approx(mesh.areas.sum(), rel=1e-4)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    if name == "glb":  # y is up
        low, high = np.array([low[0], low[2], -high[1]]), np.array([high[0], high[2], -low[1]])
    np.testing.assert_allclose(again.bounds, [low, high], atol=1e-5)


@pytest.mark.parametrize("name", ["ply", "glb"])
def test_vertices_have_the_colours_of_their_views(name, mesh, tmp_path):
    path = tmp_path / f"mesh.{name}"
    path.write_bytes(find_mesh_format(name).encode(mesh))
    again = trimesh.load(path, force="mesh", process=False)
    np.testing.assert_array_equal(again.visual.vertex_colors[:, :3], view_colours_rgb(mesh.view))


def test_unknown_formats_are_refused(mesh, tmp_path):
    with pytest.raises(UnknownNameError, match="glb, obj, ply, stl"):
        find_mesh_format("dwg")


@pytest.fixture
def others(monkeypatch):
    """Another package: a format of meshes, one of clouds, what is none and what is not there."""
    package = ModuleType("others")
    package.NAMES = MeshFormat(encode=lambda mesh: b"mesh")
    package.ROWS = CloudFormat(suffix=".rows", encode=lambda piece: b"")
    package.TABLE = {}
    monkeypatch.setitem(sys.modules, "others", package)
    places = {
        "names": "others:NAMES",
        "rows": "others:ROWS",
        "table": "others:TABLE",
        "broken": "scan3d_twin.no_such_module:X",
    }
    points = EntryPoints([EntryPoint(*each, export.ENTRY_POINTS) for each in places.items()])
    monkeypatch.setattr(export, "entry_points", lambda group: points.select(group=group))


@pytest.mark.usefixtures("others")
def test_one_broken_format_of_another_package_breaks_no_other():
    assert find_mesh_format("obj").encode
    assert find_mesh_format("names").encode(None) == b"mesh"
    assert list_mesh_formats() == ("glb", "names", "obj", "ply", "stl")
    with pytest.raises(UnknownNameError, match="glb, names, obj, ply, stl"):
        find_mesh_format("rows")


@pytest.mark.usefixtures("others")
@pytest.mark.parametrize("find", [find_format, find_mesh_format])
def test_what_is_no_format_is_refused(find):
    with pytest.raises(ConfigError, match=r"^format table \(others:TABLE\) cannot .* but {}$"):
        find("table")
    with pytest.raises(ConfigError, match=r"^format broken .*ModuleNotFoundError: No module"):
        find("broken")


def test_poisson_closes_no_hole(tmp_path):
    pytest.importorskip("open3d", exc_type=ImportError)
    rng = np.random.default_rng(0)
    points = np.column_stack([np.zeros(40_000), *rng.uniform(-0.5, 0.5, (2, 40_000))])
    points = points[np.hypot(points[:, 1], points[:, 2]) > 0.15]
    n = len(points)
    holed = Model(points, np.tile((-1.0, 0.0, 0.0), (n, 1)), np.full(n, 0.005), np.zeros(n, int))
    surface = reconstruct_poisson(holed)
    middle = surface.vertices[surface.faces].mean(axis=1)
    assert np.hypot(middle[:, 1], middle[:, 2]).min() > 0.15 - 2 * MAX_POISSON_DISTANCE
    seen, grown = (
        1 - np.pi * 0.15**2,
        (1 + 2 * MAX_POISSON_DISTANCE) ** 2 - np.pi * (0.15 - MAX_POISSON_DISTANCE) ** 2,
    )
    assert 0.97 * seen < surface.areas.sum() < 1.02 * grown
    assert np.abs(middle[:, 0]).max() < 0.01


def test_poisson_makes_a_surface_of_a_model(session):
    pytest.importorskip("open3d", exc_type=ImportError)
    surface = reconstruct_poisson(build_model(session, 0.005))
    assert len(surface.faces) > 5000
    assert set(surface.view) == {-1}
