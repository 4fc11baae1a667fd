"""An export that does not fit on the disk: one line, and nothing left of it."""

import pytest
from full_disk import full_disk
from recorded import record

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.model.fused_cloud import build_view_clouds
from scan3d_twin.core.model.mesh import build_mesh
from scan3d_twin.recording.export import find_format, find_mesh_format
from scan3d_twin.recording.export.clouds import export_cloud, pieces
from scan3d_twin.run.folder import write_file

ROOM = 4096
"""What fits of a file [bytes]: less than any of the exports."""
NEEDED = {"las": "laspy", "laz": "laspy", "e57": "pye57", "rrd": "rerun"}
"""Packages of some formats."""


def fails_in_one_line(write, folder):
    with full_disk(ROOM), pytest.raises(FileError, match=r"^cannot write \S+: .{5,80}$") as failed:
        write()
    assert len(str(failed.value).splitlines()) == 1
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("per_view", [False, True])
@pytest.mark.parametrize("name", ["ply", "pcd", "xyz", "las", "laz", "e57", "uos"])
def test_nothing_is_left_of_a_cloud(name, per_view, session, tmp_path):
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    parts = pieces(session, per_view=per_view, voxel=0.0)
    path, kind = tmp_path / "x", find_format(name)
    fails_in_one_line(lambda: export_cloud(parts, kind, path, per_view=per_view), tmp_path)


@pytest.mark.parametrize("name", ["obj", "stl", "glb", "ply"])
def test_nothing_is_left_of_a_mesh(name, session, tmp_path):
    content = find_mesh_format(name).encode(build_mesh(session, build_view_clouds(session)))
    fails_in_one_line(lambda: write_file(tmp_path / "x", content), tmp_path)


@pytest.mark.parametrize("name", ["rosbag2", "rrd"])
def test_nothing_is_left_of_a_recording(name, session, tmp_path):
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    path = record(tmp_path / "run", session).path
    (tmp_path / "out").mkdir()
    kind = find_format(name)
    fails_in_one_line(lambda: kind.write(path, tmp_path / "out" / "x"), tmp_path / "out")
