"""The table of docs/files.md, cell by cell: each file in the program itself."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from programs import PROGRAMS, Read

from scan3d_twin.core.model.fused_cloud import build_view_clouds
from scan3d_twin.core.model.mesh import build_mesh
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export import find_format, find_mesh_format
from scan3d_twin.recording.export.clouds import export_cloud, pieces

pytestmark = pytest.mark.slow
PAGE = Path(__file__).resolve().parents[3] / "docs" / "files.md"
VOXEL = 0.02
"""The cloud is fused, so that the files are small [m]."""
NEAR = 1e-4
"""Half of the last digit of xyz and LAS, and single precision [m]."""


def cells():
    """Yield file, program and content of each cell of the table."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("| file | CloudCompare"))
    programs = [each.strip() for each in lines[start].strip("|").split("|")][1:]
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            return
        name, *contents = (each.strip() for each in line.strip().strip("|").split("|"))
        for program, content in zip(programs, contents, strict=True):
            yield re.findall(r"`([^`]+)`", name)[0], program, content


TESTED = [cell for cell in cells() if cell[2] not in ("", "untested")]


@pytest.fixture(scope="module")
def mesh(session):
    """The mesh of the session."""
    return build_mesh(session, build_view_clouds(session))


@pytest.fixture(scope="module")
def files(session, mesh, tmp_path_factory):
    """All files of the table, and the clouds that are in them."""
    folder = tmp_path_factory.mktemp("files")
    fused = pieces(session, per_view=False, voxel=VOXEL)
    for name in ("ply", "pcd", "xyz", "las", "laz"):
        export_cloud(fused, find_format(name), folder / f"cloud.{name}", per_view=False)
    parts = pieces(session, per_view=True, voxel=0.0)
    export_cloud(parts, find_format("e57"), folder / "cloud.e57", per_view=True)
    for name in ("obj", "stl", "glb", "ply"):
        (folder / f"mesh.{name}").write_bytes(find_mesh_format(name).encode(mesh))
    return folder


@pytest.fixture(scope="module")
def fused(session):
    (piece,) = pieces(session, per_view=False, voxel=VOXEL)
    return piece.model


@pytest.fixture(scope="module")
def joined(session):
    (piece,) = pieces(session, per_view=False, voxel=0.0)
    return piece.model


def test_no_cell_is_left_open():
    contents = [content for _, _, content in cells()]
    assert len(contents) == 11 * len(PROGRAMS)
    assert all(re.fullmatch("|no|untested|[PNCVT]+", content) for content in contents)
    assert {program for _, program, _ in cells()} == set(PROGRAMS)


@pytest.mark.parametrize(("name", "program", "content"), TESTED)
def test_a_program_reads_what_the_table_says(
    name, program, content, files, fused, joined, mesh, tmp_path
):
    path = tmp_path / name
    shutil.copy(files / name, path)
    read = PROGRAMS[program](path)
    if content == "no":
        assert read is None
        return
    assert read is not None
    if name.startswith("mesh"):
        assert found_in_mesh(read, mesh, is_y_up=name.endswith("glb")) == content
    else:
        assert found_in_cloud(read, joined if name.endswith("e57") else fused) == content


def found_in_cloud(read: Read, model) -> str:
    """Return the letters of what ``read`` has with the values of ``model``."""
    found = ""
    if read.points.shape == model.points.shape:
        found += "P" * np.allclose(read.points, model.points, atol=NEAR)
    if read.normals is not None:
        # CloudCompare keeps normals in 21 bits: two thousandths off
        found += "N" * np.allclose(read.normals, np.nan_to_num(model.normals), atol=3e-3)
    if read.colours is not None:
        found += "C" * np.allclose(read.colours, view_colours_rgb(model.view), atol=0.6)
    if read.view is not None:
        found += "V" * np.array_equal(read.view, model.view)
    return found


def found_in_mesh(read: Read, mesh, *, is_y_up: bool) -> str:
    """Return the letters of what ``read`` has; readers may join or split vertices."""
    found = ""
    points = read.points
    if is_y_up:
        points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
    bounds = [(each.min(axis=0), each.max(axis=0)) for each in (points, mesh.vertices)]
    if read.triangles == len(mesh.faces) and np.allclose(*bounds, atol=NEAR):
        found += "T"
    if read.colours is not None:
        # MeshLab cuts the fractions of an OBJ file off, and so is up to 1 too dark
        written, seen = (
            np.unique(each, axis=0)
            for each in (view_colours_rgb(mesh.view), np.round(read.colours).astype(int))
        )
        found += "C" * (written.shape == seen.shape and np.allclose(written, seen, atol=1))
    return found
