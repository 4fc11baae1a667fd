import builtins
import io
import math
import re
import sys

import numpy as np
import pytest
import trimesh

from scan3d_twin.core.errors import ConfigError, FileError, UnknownNameError
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export import find_format
from scan3d_twin.recording.export.clouds import export_cloud, file_name, pieces


@pytest.fixture(scope="module")
def fused(session):
    """The fused cloud as one piece."""
    return pieces(session, per_view=False, voxel=0.0)


@pytest.fixture(scope="module")
def parts(session):
    """One piece per view."""
    return pieces(session, per_view=True, voxel=0.0)


def written(pieces, name, tmp_path, *, per_view=False):
    kind = find_format(name)
    path = tmp_path / file_name(name, kind, per_view=per_view)
    return export_cloud(pieces, kind, path, per_view=per_view)


def points_of_pcd(content):
    """Read a PCD file by the words of its header, as any reader of the format does."""
    header, data = re.split(rb"(?<=DATA binary\n)", content, maxsplit=1)
    words = {line.split()[0]: line.split()[1:] for line in header.decode().splitlines()}
    kinds = {"F": "f4", "U": "u4"}
    names, types = words["FIELDS"], [kinds[kind] for kind in words["TYPE"]]
    return words, np.frombuffer(data, np.dtype(list(zip(names, types, strict=True))))


def test_ply_is_read_by_trimesh_with_normals_and_colours(fused, tmp_path):
    (path,) = written(fused, "ply", tmp_path)
    cloud, model = trimesh.load(path), fused[0].model
    np.testing.assert_allclose(cloud.vertices, model.points, atol=1e-6)
    np.testing.assert_array_equal(cloud.colors[:, :3], view_colours_rgb(model.view))
    vertex = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(np.ravel(vertex["nz"]), model.normals[:, 2], atol=1e-6)
    np.testing.assert_array_equal(np.ravel(vertex["view"]), model.view)


def test_pcd_says_what_it_holds(parts, tmp_path):
    paths = written(parts, "pcd", tmp_path, per_view=True)
    words, points = points_of_pcd(paths[1].read_bytes())
    model, pose = parts[1].model, parts[1].T_world_piece
    assert int(words["POINTS"][0]) == int(words["WIDTH"][0]) == len(points) == len(model)
    np.testing.assert_allclose(points["y"], model.points[:, 1], atol=1e-6)
    np.testing.assert_array_equal(points["label"], model.view)
    x, y, z, qw, qx, qy, qz = map(float, words["VIEWPOINT"])
    assert (z, qx, qy) == (0, 0, 0)
    assert Pose2(x, y, 2 * math.atan2(qz, qw)).distance(pose) < 1e-6


def test_pcd_is_read_by_open3d(fused, tmp_path):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    (path,) = written(fused, "pcd", tmp_path)
    cloud = open3d.io.read_point_cloud(str(path))
    np.testing.assert_allclose(np.asarray(cloud.points), fused[0].model.points, atol=1e-6)
    np.testing.assert_allclose(np.asarray(cloud.normals), fused[0].model.normals, atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(cloud.colors) * 255, view_colours_rgb(fused[0].model.view), atol=0.6
    )


def test_xyz_is_read_by_trimesh(fused, tmp_path):
    (path,) = written(fused, "xyz", tmp_path)
    np.testing.assert_allclose(trimesh.load(path).vertices, fused[0].model.points, atol=6e-5)


@pytest.mark.parametrize("name", ["las", "laz"])
def test_las_and_laz_are_read_by_laspy(name, fused, tmp_path):
    laspy = pytest.importorskip("laspy")
    (path,) = written(fused, name, tmp_path)
    cloud, model = laspy.read(path), fused[0].model
    np.testing.assert_allclose(cloud.xyz, model.points, atol=6e-5)
    np.testing.assert_array_equal(cloud.point_source_id, model.view)
    np.testing.assert_array_equal(np.asarray(cloud.red) // 257, view_colours_rgb(model.view)[:, 0])


def test_e57_keeps_the_views_and_their_poses(parts, tmp_path):
    pye57 = pytest.importorskip("pye57")
    (path,) = written(parts, "e57", tmp_path, per_view=True)
    file = pye57.E57(str(path))
    assert file.scan_count == len(parts)
    for index, part in enumerate(parts):
        scan = file.read_scan(index, ignore_missing_fields=True, colors=True)
        world = part.T_world_piece.apply(part.model.points)
        placed = np.stack([scan[f"cartesian{name}"] for name in "XYZ"], axis=1)
        np.testing.assert_allclose(placed, world, atol=1e-6)
        np.testing.assert_array_equal(scan["colorRed"], view_colours_rgb(part.model.view)[:, 0])
    file.close()


def test_uos_scans_lie_in_the_world_by_3dtks_own_transform(parts, tmp_path):
    paths = written(parts, "uos", tmp_path, per_view=True)
    assert [path.name for path in paths[:2]] == ["scan000.3d", "scan000.pose"]
    for part, scan, pose in zip(parts, paths[::2], paths[1::2], strict=True):
        place, angles = np.loadtxt(pose)
        np.testing.assert_array_equal(angles[[0, 2]], 0)
        c, s = np.cos(np.radians(angles[1])), np.sin(np.radians(angles[1]))
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # EulerToMatrix4 of 3DTK, about y alone
        x, y, z = (np.loadtxt(scan) @ turn.T + place).T / 100
        world = part.T_world_piece.apply(part.model.points)
        np.testing.assert_allclose(np.stack([z, -x, y], axis=1), world, atol=2e-4)


def test_views_apart_come_with_a_table_of_poses(parts, tmp_path):
    paths = written(parts, "ply", tmp_path, per_view=True)
    assert [path.name for path in paths] == ["view_000.ply", "view_001.ply", "poses.csv"]
    rows = paths[-1].read_text().splitlines()
    assert rows[0] == "name,x_m,y_m,yaw_rad"
    name, x, y, yaw = rows[2].split(",")
    pose = Pose2(float(x), float(y), float(yaw))
    placed = pose.apply(np.asarray(trimesh.load(tmp_path / "ply_views" / f"{name}.ply").vertices))
    np.testing.assert_allclose(
        placed, parts[1].T_world_piece.apply(parts[1].model.points), atol=1e-5
    )


def test_voxels_fuse_the_views(session, fused):
    (coarse,) = pieces(session, per_view=False, voxel=0.02)
    assert len(coarse.model) < len(fused[0].model) / 4
    with pytest.raises(ConfigError, match="give one"):
        pieces(session, per_view=True, voxel=0.02)


@pytest.mark.parametrize("name", ["las", "pcd", "ply"])
def test_a_file_in_millimetres_has_the_same_points(name, session, parts, tmp_path):
    laspy = pytest.importorskip("laspy")
    scaled = pieces(session, per_view=True, voxel=0.0, unit="mm")[1]
    content = find_format(name).encode(scaled)
    if name == "las":
        points = laspy.read(io.BytesIO(content)).xyz
    elif name == "pcd":
        words, read = points_of_pcd(content)
        points = np.stack([read[axis] for axis in "xyz"], axis=1)
        x, y = map(float, words["VIEWPOINT"][:2])
        pose = parts[1].T_world_piece
        assert (x, y) == pytest.approx((1000 * pose.x, 1000 * pose.y))
    else:
        assert b"comment scan3d_twin: millimetres\n" in content
        points = trimesh.load(io.BytesIO(content), file_type="ply").vertices
    np.testing.assert_allclose(points, 1000 * parts[1].model.points, atol=0.051)


@pytest.mark.parametrize("name", ["e57", "las", "laz", "pcd", "ply", "uos", "xyz"])
def test_the_same_run_gives_the_same_bytes(name, fused, tmp_path):
    first, second = (written(fused, name, tmp_path / each) for each in "ab")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]


@pytest.mark.parametrize(
    ("name", "library"), [("las", "laspy"), ("laz", "laspy"), ("e57", "pye57")]
)
def test_a_missing_library_is_named_with_its_cure(name, library, fused, tmp_path, monkeypatch):
    whole = builtins.__import__

    def without(wanted, *arguments, **options):
        """Import as usual, except for the missing library."""
        if wanted.split(".")[0] == library:
            raise ImportError(wanted)
        return whole(wanted, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ConfigError, match=f"pip install '?{library}"):
        written(fused, name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_rerun_is_named_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ConfigError, match=r"pip install rerun-sdk"):
        find_format("rrd").write(tmp_path / "session.mcap", tmp_path / "session.rrd")


@pytest.mark.parametrize("name", ["ply", "e57"])
def test_a_place_that_cannot_be_written_is_a_file_error(name, fused, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write"):
        export_cloud(fused, find_format(name), tmp_path / "file" / "x", per_view=False)


def test_unknown_formats_are_named_with_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"known: .*laz.*ply"):
        find_format("dxf")
