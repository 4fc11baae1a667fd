"""Test helper: what other programs read from a file that we wrote.

Each function returns a ``Read``, or None where the program does not open the format. A program that
is not installed skips the test.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest


@dataclass
class Read:
    """What a program read.

    Attributes:
        points: Points or vertices (n, 3).
        colours: 0..255 (n, 3).
        normals: (n, 3).
        view: Index of the view (n,).
        triangles: Their number.
    """

    points: np.ndarray
    colours: np.ndarray | None = None
    normals: np.ndarray | None = None
    view: np.ndarray | None = None
    triangles: int = 0


def program(name: str) -> str:
    """Return the path of a program, or skip."""
    path = shutil.which(name)
    if path is None:
        pytest.skip(f"{name} is not installed")
    return path


def run(path: Path, *arguments: object) -> str:
    """Run a program beside the file ``path`` and return what it prints."""
    environment = {
        **os.environ,
        "HOME": str(path.parent),
        "XDG_RUNTIME_DIR": str(path.parent),
        "QT_QPA_PLATFORM": "offscreen",
    }
    done = subprocess.run(
        [str(each) for each in arguments],
        cwd=path.parent,
        env=environment,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=60,
    )
    return done.stdout + done.stderr


def read_with_cloudcompare(path: Path) -> Read | None:
    """Read with CloudCompare's command line, which writes clouds and meshes again as text."""
    told = run(
        path, program("CloudCompare"), "-SILENT", "-C_EXPORT_FMT", "ASC", "-ADD_HEADER", "-PREC", 7,
        "-M_EXPORT_FMT", "PLY", "-PLY_EXPORT_FMT", "ASCII", "-NO_TIMESTAMP", "-O", path.name,
        "-SAVE_CLOUDS", "-SAVE_MESHES",
    )  # fmt: skip
    if "unhandled file extension" in told:
        return None
    assert "saved successfully" in told, told
    text = path.with_suffix(".asc")
    if not text.exists():
        return _ascii_ply(path.with_suffix(".ply"))
    columns = text.read_text().split("\n", 1)[0].removeprefix("//").split()
    table = dict(zip(columns, np.loadtxt(text, skiprows=1).T, strict=True))
    points = _columns(table, "X", "Y", "Z")
    assert points is not None
    colours, normals = _columns(table, "R", "G", "B"), _columns(table, "Nx", "Ny", "Nz")
    return Read(points, colours, normals, table.get("view"))


def _columns(table: dict[str, np.ndarray], *names: str) -> np.ndarray | None:
    found = [name in table for name in names]
    return np.stack([table[name] for name in names], axis=1) if all(found) else None


def read_with_meshlab(path: Path) -> Read | None:
    """Read with PyMeshLab; several meshes, such as the scans of an E57 file, as one."""
    pymeshlab = pytest.importorskip("pymeshlab", exc_type=ImportError)
    meshes = pymeshlab.MeshSet()
    try:
        meshes.load_new_mesh(str(path))
    except pymeshlab.PyMeshLabException as error:
        if "Unknown format" not in str(error):
            raise
        return None
    parts = list(meshes)
    first = parts[0]
    return Read(
        np.concatenate([_placed_by_meshlab(each) for each in parts]),
        np.concatenate([255 * each.vertex_color_matrix()[:, :3] for each in parts])
        if first.has_vertex_color()
        else None,
        np.concatenate([each.vertex_normal_matrix() for each in parts]),
        first.vertex_scalar_array() if first.has_vertex_scalar() else None,
        sum(each.face_number() for each in parts),
    )


def _placed_by_meshlab(mesh) -> np.ndarray:  # type: ignore[no-untyped-def]
    T, points = mesh.transform_matrix(), mesh.vertex_matrix()
    return points @ T[:3, :3].T + T[:3, 3]


def read_with_pcl(path: Path) -> Read | None:
    """Read with the converters of PCL, which write a PLY file as text."""
    if path.suffix == ".pcd":
        told = run(path, program("pcl_pcd2ply"), "-format", 0, path.name, "again.ply")
    elif path.suffix == ".ply" and path.stem != "mesh":
        run(path, program("pcl_ply2pcd"), path.name, "between.pcd")
        told = run(path, program("pcl_pcd2ply"), "-format", 0, "between.pcd", "again.ply")
    else:
        told = run(path, program("pcl_converter"), "-f", "ascii", path.name, "again.ply")
    again = path.parent / "again.ply"
    if not again.exists():
        assert told
        return None
    return _ascii_ply(again)


def _ascii_ply(path: Path) -> Read:
    header, _, body = path.read_text().partition("end_header\n")
    words = [line.split() for line in header.splitlines()]
    elements = [k for k, row in enumerate(words) if row[0] == "element"]
    count = int(words[elements[0]][2])
    last = elements[1] if len(elements) > 1 else len(words)
    names = [row[-1] for row in words[elements[0] + 1 : last] if row[0] == "property"]
    faces = {words[k][1]: int(words[k][2]) for k in elements}.get("face", 0)
    table = dict(zip(names, np.loadtxt(body.splitlines()[:count]).T, strict=True))
    points = _columns(table, "x", "y", "z")
    assert points is not None
    colours, normals = _columns(table, "red", "green", "blue"), _columns(table, "nx", "ny", "nz")
    return Read(points, colours, normals, table.get("label", table.get("view")), faces)


def read_with_open3d(path: Path) -> Read | None:
    """Read with Open3D; the tensor interface for scalars."""
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    if path.stem == "mesh":
        mesh = open3d.io.read_triangle_mesh(str(path))
        colours = 255 * np.asarray(mesh.vertex_colors) if mesh.has_vertex_colors() else None
        return Read(np.asarray(mesh.vertices), colours, triangles=len(mesh.triangles))
    cloud = open3d.t.io.read_point_cloud(str(path))
    if "positions" not in cloud.point or len(cloud.point.positions) == 0:
        return None

    def pick(name: str) -> np.ndarray | None:
        return cloud.point[name].numpy() if name in cloud.point else None

    view = pick("view")
    view = pick("label") if view is None else view
    points = pick("positions")
    assert points is not None
    return Read(points, pick("colors"), pick("normals"), None if view is None else view.ravel())


def read_with_laspy(path: Path) -> Read | None:
    """Read with laspy, which wrote the file too."""
    laspy = pytest.importorskip("laspy")
    cloud = laspy.read(path)
    colours = np.stack([cloud.red, cloud.green, cloud.blue], axis=1) / 257
    return Read(np.asarray(cloud.xyz), colours, view=np.asarray(cloud.point_source_id))


def read_with_pye57(path: Path) -> Read | None:
    """Read all scans with pye57, in the frame of the file."""
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(path))
    scans = [
        file.read_scan(k, ignore_missing_fields=True, colors=True) for k in range(file.scan_count)
    ]
    file.close()
    points, colours = (
        np.concatenate([np.stack([s[n] for n in names], axis=1) for s in scans])
        for names in (
            ("cartesianX", "cartesianY", "cartesianZ"),
            ("colorRed", "colorGreen", "colorBlue"),
        )
    )
    return Read(points, colours)


def read_with_rerun(path: Path) -> Read | None:
    """Read with rerun's importers, which warn of what they leave out."""
    rerun = pytest.importorskip("rerun", exc_type=ImportError)
    chunks = pytest.importorskip("rerun.chunk", exc_type=ImportError)
    target = path.parent / "again.rrd"
    stream = rerun.RecordingStream("test")
    stream.save(target)
    with nullcontext() if path.suffix in OPENED_BY_RERUN else pytest.warns():
        stream.log_file_from_path(path)
    stream.flush()
    stream.disconnect()
    rows = {}
    for chunk in chunks.RrdReader(target).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            rows.setdefault(name, []).extend(batch.column(name).to_pylist())
    if "Points3D:positions" not in rows:
        return None
    packed = np.array(rows["Points3D:colors"][0], dtype=np.uint32)
    colours = np.stack([packed >> shift & 255 for shift in (24, 16, 8)], axis=1)
    return Read(np.array(rows["Points3D:positions"][0]), colours)


OPENED_BY_RERUN = (".ply",)
PROGRAMS: dict[str, Callable[[Path], Read | None]] = {
    "CloudCompare": read_with_cloudcompare,
    "MeshLab": read_with_meshlab,
    "PCL": read_with_pcl,
    "Open3D": read_with_open3d,
    "laspy": read_with_laspy,
    "pye57": read_with_pye57,
    "rerun": read_with_rerun,
}
"""Programs by their names in the table of docs/files.md."""
