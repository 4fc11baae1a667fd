"""Header values by the specification of each format, read without the library that wrote them."""

import struct
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.recording.export import find_format
from scan3d_twin.recording.export.clouds import export_cloud, pieces
from scan3d_twin.recording.export.piece import Piece

E57_NAMESPACE = "{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}"
E57_PAGE, E57_CHECKSUM = 1024, 4
"""Pages of an E57 file, each ending with a checksum [bytes] (ASTM E2807, 9.2)."""
OPTIONAL_CLAIMS = (
    "temperature", "relativeHumidity", "atmosphericPressure", "acquisitionStart",
    "acquisitionEnd", "indexBounds",
)  # fmt: skip
"""Elements of a scan that say something we do not know."""


def written(parts, name, path, *, per_view=True):
    return export_cloud(parts, find_format(name), path, per_view=per_view)


@pytest.fixture(scope="module")
def parts(session):
    """One piece per view, each in its own frame."""
    return pieces(session, per_view=True, voxel=0.0)


def e57_root(path):
    """Return the XML section of an E57 file, by the header and the pages of the standard."""
    content = path.read_bytes()
    signature, major, minor, length, offset, size, page = struct.unpack("<8sIIQQQQ", content[:48])
    assert (signature, major, minor, page) == (b"ASTM-E57", 1, 0, E57_PAGE)
    assert length == len(content)
    pages = [content[k : k + page - E57_CHECKSUM] for k in range(0, length, page)]
    start = offset // page * (page - E57_CHECKSUM) + offset % page
    return ElementTree.fromstring(b"".join(pages)[start : start + size])


def child(node, *names):
    for name in names:
        node = node.find(E57_NAMESPACE + name)
    return node


def number(node, *names):
    return float(child(node, *names).text or 0)


def test_e57_bounds_are_those_of_the_points_in_the_frame_of_the_scan(parts, tmp_path):
    pytest.importorskip("pye57")
    (path,) = written(parts, "e57", tmp_path / "x.e57")
    for part, scan in zip(parts, child(e57_root(path), "data3D"), strict=True):
        points = part.model.points.astype(np.float32)
        for axis, values in zip("xyz", points.T, strict=True):
            low, high = (
                number(scan, "cartesianBounds", f"{axis}{end}") for end in ("Minimum", "Maximum")
            )
            assert (low, high) == (values.min(), values.max())
            field = child(scan, "points", "prototype", f"cartesian{axis.upper()}")
            ends = [np.float32(field.get(end)) for end in ("minimum", "maximum")]
            assert ends == [low, high]
            assert field.get("precision") == "single"


def test_e57_says_what_is_known_and_nothing_else(parts, tmp_path):
    pytest.importorskip("pye57")
    (path,) = written(parts, "e57", tmp_path / "x.e57")
    root = e57_root(path)
    assert child(root, "formatName").text == "ASTM E57 3D Imaging Data File"
    assert child(root, "creationDateTime") is None
    scans = list(child(root, "data3D"))
    guids = [child(node, "guid").text for node in (root, *scans)]
    assert len(set(guids)) == len(parts) + 1
    for part, scan in zip(parts, scans, strict=True):
        assert child(scan, "name").text == part.name
        assert int(child(scan, "points").get("recordCount")) == len(part.model)
        assert [child(scan, name) for name in OPTIONAL_CLAIMS] == [None] * len(OPTIONAL_CLAIMS)
        limits = [number(scan, "colorLimits", f"color{c}Maximum") for c in ("Red", "Green", "Blue")]
        assert limits == [255, 255, 255]
        w, z = (number(scan, "pose", "rotation", name) for name in "wz")
        x, y = (number(scan, "pose", "translation", name) for name in "xy")
        assert Pose2(x, y, 2 * np.arctan2(z, w)).distance(part.T_world_piece) < 1e-12


def test_e57_takes_a_view_without_points(parts, tmp_path):
    pye57 = pytest.importorskip("pye57")
    nothing = Piece("view_002", parts[0].model.select(np.zeros(0, dtype=np.int64)), Pose2())
    (path,) = written([*parts, nothing], "e57", tmp_path / "x.e57")
    last = list(child(e57_root(path), "data3D"))[-1]
    assert child(last, "cartesianBounds") is None
    file = pye57.E57(str(path))
    assert [file.get_header(k).point_count for k in range(3)] == [
        *map(len, (p.model for p in parts)),
        0,
    ]
    file.close()


def las_header(content):
    """Return the public header block of LAS 1.2 (ASPRS, 2008) and the points of format 2."""
    names = [
        "signature",
        "source",
        "encoding",
        "guid",
        "major",
        "minor",
        "system",
        "software",
        "day",
        "year",
        "size",
        "offset",
        "vlrs",
        "format",
        "length",
        "count",
        "returns",
        "scale_offset",
        "bounds",
    ]
    values = struct.unpack("<4sHH16sBB32s32sHHHIIBHI20s48s48s", content[:227])
    header = dict(zip(names, values, strict=True))
    assert (header["signature"], header["major"], header["minor"]) == (b"LASF", 1, 2)
    assert (header["size"], header["format"], header["length"]) == (227, 2, 26)
    point = np.dtype(
        [
            ("xyz", "<i4", 3),
            ("intensity", "<u2"),
            *((name, "u1") for name in ("flags", "class", "angle", "user")),
            ("source", "<u2"),
            ("rgb", "<u2", 3),
        ]
    )
    return header, np.frombuffer(content, point, header["count"], header["offset"])


def test_las_header_is_that_of_its_points(parts, tmp_path):
    pytest.importorskip("laspy")
    model = parts[1].model
    header, points = las_header(find_format("las").encode(parts[1]))
    scale, offset = np.frombuffer(header["scale_offset"], "<f8").reshape(2, 3)
    placed = points["xyz"] * scale + offset
    np.testing.assert_allclose(placed, model.points, atol=6e-5)
    highs, lows = np.frombuffer(header["bounds"], "<f8").reshape(3, 2).T
    np.testing.assert_allclose([lows, highs], [placed.min(axis=0), placed.max(axis=0)], atol=1e-9)
    assert header["count"] == len(model)
    np.testing.assert_array_equal(points["rgb"] // 257, view_colours_rgb(model.view))


def test_las_points_are_the_first_of_one_return(parts, tmp_path):
    """Returns count from 1; no mirror, no edges of flight lines, never classified, no date."""
    pytest.importorskip("laspy")
    header, points = las_header(find_format("las").encode(parts[1]))
    assert list(struct.unpack("<5I", header["returns"])) == [len(points), 0, 0, 0, 0]
    flags = points["flags"]
    number, of, direction, edge = flags & 7, flags >> 3 & 7, flags >> 6 & 1, flags >> 7
    assert set(number) == set(of) == {1}
    for unset in (direction, edge, points["class"], points["angle"], points["user"]):
        assert not unset.any()
    np.testing.assert_array_equal(points["source"], parts[1].model.view)
    assert (header["day"], header["year"], header["source"]) == (0, 0, 0)


def test_pcd_has_its_colour_in_the_bits_of_a_float(parts, tmp_path):
    content = find_format("pcd").encode(parts[1])
    head, data = content.split(b"DATA binary\n", 1)
    words = {line.split()[0]: line.split()[1:] for line in head.decode().splitlines()}
    kinds = dict(zip(words["FIELDS"], words["TYPE"], strict=True))
    assert (kinds["rgb"], kinds["label"]) == ("F", "U")
    points = np.frombuffer(
        data, np.dtype([("floats", "<f4", 6), ("bgra", "u1", 4), ("label", "<u4")])
    )
    np.testing.assert_array_equal(points["bgra"][:, 2::-1], view_colours_rgb(parts[1].model.view))
    assert np.isfinite(points["bgra"].copy().view("<f4")).all()


def test_a_model_without_points_is_no_file(session, monkeypatch):
    nothing = Model(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    monkeypatch.setattr("scan3d_twin.recording.export.clouds.build_model", lambda *_: nothing)
    with pytest.raises(ScanError, match="no point of the target; nothing is written"):
        pieces(session, per_view=False, voxel=0.0)
