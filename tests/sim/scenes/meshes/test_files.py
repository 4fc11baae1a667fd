"""Mesh files as strangers write them: read right, or refused by the name of what is not read."""

import json
import struct

import numpy as np
import pytest
import trimesh

from scan3d_twin.core.errors import ConfigError, SceneError
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import MujocoCaster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.meshes.cleanup import drop_surroundings
from scan3d_twin.sim.scenes.meshes.files import OTHER_SUFFIXES, read_mesh
from scan3d_twin.sim.scenes.meshes.polygons import triangulate
from scan3d_twin.sim.truth import Truth

STEPS = np.array([[0, 0], [0.6, 0], [0.6, 0.2], [0.4, 0.2], [0.4, 0.4], [0.2, 0.4], [0.2, 0.6]])
"""Corners of a concave polygon, without the last one at (0, 0.6)."""
OUTLINE = np.vstack([STEPS, [[0.0, 0.6]]])
OUTLINE_AREA = 0.2 * (0.6 + 0.4 + 0.2)
HEIGHT = 0.4


def stairs():
    """Return vertices and polygons of a prism over a concave outline, and its area."""
    n = len(OUTLINE)
    vertices = np.vstack([np.c_[OUTLINE, np.zeros(n)], np.c_[OUTLINE, np.full(n, HEIGHT)]])
    sides = [[k, (k + 1) % n, (k + 1) % n + n, k + n] for k in range(n)]
    polygons = [list(range(n))[::-1], list(range(n, 2 * n)), *sides]
    around = np.linalg.norm(np.roll(OUTLINE, -1, axis=0) - OUTLINE, axis=1).sum()
    return vertices, polygons, 2 * OUTLINE_AREA + HEIGHT * around


def as_obj(vertices, polygons):
    """Return an OBJ file, whose faces count from 1 or from the end."""
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    for number, polygon in enumerate(polygons):
        shift = 1 if number % 2 else -len(vertices)
        lines.append("f " + " ".join(f"{k + shift}/7/3" for k in polygon))
    return "\n".join(lines).encode()


def as_off(vertices, polygons):
    """Return an OFF file."""
    lines = ["OFF # by hand", f"{len(vertices)} {len(polygons)} 0"]
    lines += [f"{x} {y} {z}" for x, y, z in vertices]
    lines += [" ".join(map(str, [len(polygon), *polygon, 255, 0, 0])) for polygon in polygons]
    return "\n".join(lines).encode()


def ply_header(form, vertices, rows):
    """Return the header of a PLY file with ``rows`` of the other element."""
    return (
        f"ply\nformat {form} 1.0\ncomment by hand\nelement vertex {vertices}\nproperty float x\n"
        f"property float y\nproperty double z\nproperty uchar red\n{rows}end_header\n"
    ).encode()


def as_ply(order):
    """Return what writes a PLY file of a byte ``order``, or as text."""

    def write(vertices, polygons):
        """Return a PLY file."""
        rows = f"element face {len(polygons)}\nproperty list uchar int vertex_indices\n"
        rows += "property uchar flags\n"
        if order == "":
            lines = [f"{x} {y} {z} 9" for x, y, z in vertices]
            lines += [" ".join(map(str, [len(p), *p, 0])) for p in polygons]
            return ply_header("ascii", len(vertices), rows) + "\n".join(lines).encode()
        form = "binary_little_endian" if order == "<" else "binary_big_endian"
        body = b"".join(struct.pack(f"{order}ffdB", *vertex, 9) for vertex in vertices)
        for polygon in polygons:
            body += struct.pack(f"{order}B{len(polygon)}iB", len(polygon), *polygon, 0)
        return ply_header(form, len(vertices), rows) + body

    return write


WRITERS = {
    "a.obj": as_obj,
    "a.off": as_off,
    "text.ply": as_ply(""),
    "little.ply": as_ply("<"),
    "big.ply": as_ply(">"),
}


def area(vertices, faces):
    """Return the area of triangles."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@pytest.mark.parametrize("name", WRITERS)
def test_concave_polygons_are_not_filled(tmp_path, name):
    vertices, polygons, expected = stairs()
    (tmp_path / name).write_bytes(WRITERS[name](vertices, polygons))
    points, faces = read_mesh(tmp_path / name)
    assert area(points, faces) == pytest.approx(expected, abs=1e-6)
    assert len(faces) == sum(len(polygon) - 2 for polygon in polygons)


@pytest.mark.parametrize("name", WRITERS)
def test_indices_out_of_range_are_one_line(tmp_path, name):
    vertices, polygons, _ = stairs()
    polygons[3] = [0, 1, 99]
    (tmp_path / name).write_bytes(WRITERS[name](vertices, polygons))
    with pytest.raises(SceneError, match=r"a face refers to vertex \d+ .* of 16; export"):
        load_scene(str(tmp_path / name))


@pytest.mark.parametrize("name", [name for name in WRITERS if name[:-4] not in ("little", "big")])
@pytest.mark.parametrize("number", [10**30, -(10**30), 2**63, 2**64])
def test_indices_of_more_than_64_bits_are_one_line(tmp_path, name, number):
    vertices, polygons, _ = stairs()
    polygons[3] = [0, 1, number]
    (tmp_path / name).write_bytes(WRITERS[name](vertices, polygons))
    with pytest.raises(SceneError, match=name) as caught:
        load_scene(str(tmp_path / name))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("order", ["", "<"])
@pytest.mark.parametrize("kind", ["list uchar float", "float"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e30])
def test_indices_of_a_ply_file_that_are_no_integers_are_one_line(tmp_path, order, kind, value):
    header = ply_header("binary_little_endian" if order else "ascii", 3,
                        f"element face 1\nproperty {kind} vertex_indices\n")  # fmt: skip
    corners = [0.0, 1.0, value] if kind != "float" else [value]
    if order:
        body = b"".join(struct.pack("<ffdB", k, k * k, 0, 9) for k in range(3))
        body += struct.pack("<B", 3) if len(corners) == 3 else b""
        body += struct.pack(f"<{len(corners)}f", *corners)
    else:
        lines = [f"{k} {k * k} 0 9" for k in range(3)]
        count = ["3"] if len(corners) == 3 else []
        body = "\n".join([*lines, " ".join(count + [str(c) for c in corners])]).encode()
    (tmp_path / "a.ply").write_bytes(header + body)
    with pytest.raises(SceneError, match=r"a\.ply") as caught:
        load_scene(str(tmp_path / "a.ply"))
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_ends_early_is_one_line(tmp_path, name):
    vertices, polygons, _ = stairs()
    content = WRITERS[name](vertices, polygons)
    for share in (0.1, 0.3) if name == "a.obj" else (0.1, 0.5, 0.8):
        (tmp_path / name).write_bytes(content[: int(share * len(content))])
        with pytest.raises(SceneError, match=name) as caught:
            load_scene(str(tmp_path / name))
        assert "\n" not in str(caught.value)


def test_ears_are_cut_in_any_plane():
    rng = np.random.default_rng(2)
    angles = np.linspace(0, 2 * np.pi, 31)[:-1]
    star = (rng.uniform(0.3, 1.0, 30)[:, None]) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    x, y = star.T
    expected = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    for _ in range(5):
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        points = np.c_[star, np.zeros(30)] @ turn.T + rng.standard_normal(3)
        for ring in (np.arange(30), np.arange(30)[::-1]):
            faces = triangulate(points, [ring], "star")
            normals = np.cross(
                points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
            )
            assert area(points, faces) == pytest.approx(expected)
            assert (normals @ normals.sum(axis=0) > 0).all()


def test_triangle_strips_are_read(tmp_path):
    box = [(x, y, z) for x in (-0.3, 0.3) for y in (-0.3, 0.3) for z in (0, 0.5)]
    rows = "element tristrips 1\nproperty list int int vertex_indices\n"
    lines = [f"{x} {y} {z} 0" for x, y, z in box]
    strip = [0, 2, 1, 3, 5, 7, 4, 6, -1, 4, 0, 5, 1, -1, 2, 6, 3, 7]
    lines.append(" ".join(map(str, [len(strip), *strip])))
    content = ply_header("ascii", 8, rows) + "\n".join(lines).encode()
    (tmp_path / "strips.ply").write_bytes(content)
    points, faces = read_mesh(tmp_path / "strips.ply")
    assert len(faces) == 6 + 2 + 2
    normals = np.cross(
        points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    )
    outwards = points[faces].mean(axis=1) - (0, 0, 0.25)
    signs = np.sign(np.einsum("ni,ni->n", normals, outwards))
    assert len(set(signs[:6].tolist())) == 1  # one strip is wound one way


def write_gltf(path, mesh, change):
    """Write ``mesh`` as a .glb file whose JSON part is changed by ``change``."""
    data = trimesh.Scene(mesh).export(file_type="glb")
    length = struct.unpack("<I", data[12:16])[0]
    tree = json.loads(data[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)


def require(extension):
    """Return what lets a glTF file require an ``extension``."""

    def change(tree):
        tree["extensionsUsed"] = tree["extensionsRequired"] = [extension]

    return change


def set_primitive(**values):
    """Return what changes the primitive of a glTF file, or the accessor of its positions."""

    def change(tree):
        primitive = tree["meshes"][0]["primitives"][0]
        accessor = tree["accessors"][primitive["attributes"]["POSITION"]]
        for key, value in values.items():
            (primitive if key == "mode" else accessor)[key] = value

    return change


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (require("KHR_draco_mesh_compression"), "extension KHR_draco_mesh_compression"),
        (require("EXT_meshopt_compression"), "extension EXT_meshopt_compression"),
        (require("ACME_secret_geometry"), "extension ACME_secret_geometry"),
        (lambda tree: tree.update(extensionsUsed=["EXT_mesh_gpu_instancing"]), "gpu_instancing"),
        (set_primitive(mode=6), "triangle fans"),
        (set_primitive(normalized=True), "normalised positions .KHR_mesh_quantization"),
        (set_primitive(sparse={"count": 1}), "sparse positions"),
    ],
)
def test_what_is_not_read_of_gltf_is_refused_by_name(tmp_path, change, named):
    path = tmp_path / "thing.glb"
    write_gltf(path, trimesh.creation.box((0.3, 0.5, 0.4)), change)
    with pytest.raises(SceneError, match=rf"thing\.glb .*{named}"):
        load_scene(str(path))


def test_extensions_that_leave_the_geometry_alone_are_no_hindrance(tmp_path):
    path = tmp_path / "thing.glb"
    write_gltf(path, trimesh.creation.box((0.3, 0.5, 0.4)), require("KHR_materials_unlit"))
    assert np.ptp(read_mesh(path)[0], axis=0) == pytest.approx([0.3, 0.5, 0.4])


def test_quantised_positions_are_read(tmp_path):
    path = tmp_path / "thing.gltf"
    corners = trimesh.creation.box((2, 4, 6))
    positions = np.zeros((8, 4), np.int16)
    positions[:, :3] = corners.vertices
    blob = positions.tobytes() + corners.faces.astype(np.uint16).tobytes()
    (tmp_path / "thing.bin").write_bytes(blob)
    views = [
        {"buffer": 0, "byteOffset": 0, "byteLength": 64, "byteStride": 8},
        {"buffer": 0, "byteOffset": 64, "byteLength": 72},
    ]
    low, high = corners.bounds.tolist()
    accessors = [
        {"bufferView": 0, "componentType": 5122, "count": 8, "type": "VEC3", "min": low},
        {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
    ]
    accessors[0]["max"] = high
    tree = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_mesh_quantization"],
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [0.1, 0.1, 0.1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"uri": "thing.bin", "byteLength": len(blob)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    path.write_text(json.dumps(tree))
    vertices, faces = read_mesh(path)
    assert area(vertices, faces) == pytest.approx(0.01 * 2 * (8 + 12 + 24), rel=1e-5)


@pytest.mark.parametrize("suffix", [".fbx", ".step", ".3mf", ".dae", ".usdz", ".FBX"])
def test_formats_that_are_not_read_are_named(suffix):
    assert suffix.lower() in OTHER_SUFFIXES
    with pytest.raises(
        SceneError, match=rf"files of type {suffix.lower()} are not read; export as"
    ):
        load_scene(f"chair{suffix}")


def test_any_file_of_an_unknown_format_is_named(tmp_path):
    (tmp_path / "chair.acme").write_bytes(b"1")
    with pytest.raises(SceneError, match=r"files of type \.acme are not read"):
        load_scene(str(tmp_path / "chair.acme"))


def test_a_speck_far_off_is_left_out_and_said(tmp_path):
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    speck = trimesh.creation.box((0.001, 0.001, 0.001))
    speck.apply_translation([8, 8, 0])
    trimesh.util.concatenate([box, speck]).export(tmp_path / "stray.stl")
    scene = load_scene(str(tmp_path / "stray.stl"))
    assert scene.notes == (
        "1 loose speck(s) far from the rest of the mesh were left out (12 of 24 faces).",
    )
    assert scene.spawn.x == pytest.approx(-0.15 - 1.5, abs=1e-6)


def test_small_parts_near_by_belong_to_the_thing(tmp_path):
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    knob = trimesh.creation.box((0.01, 0.01, 0.01))
    knob.apply_translation([0.2, 0, 0])
    trimesh.util.concatenate([box, knob]).export(tmp_path / "knob.stl")
    scene = load_scene(str(tmp_path / "knob.stl"))
    assert scene.notes == ()
    assert scene.model.nmeshface == 24


def test_a_ground_plate_is_taken_for_the_floor_and_said(tmp_path):
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    plate = trimesh.creation.box((3, 3, 0.01))
    plate.apply_translation([0.2, 0, -0.255])
    trimesh.util.concatenate([box, plate]).export(tmp_path / "plate.stl")
    scene = load_scene(str(tmp_path / "plate.stl"))
    assert "A plate of 3 x 3" in scene.notes[0]
    assert scene.model.nmeshface == 12
    assert scene.spawn.x == pytest.approx(-0.15 - 1.5, abs=1e-6)


def test_a_pedestal_is_part_of_the_thing(tmp_path):
    box = trimesh.creation.box((0.3, 0.4, 0.5))
    pedestal = trimesh.creation.box((0.4, 0.5, 0.005))
    pedestal.apply_translation([0, 0, -0.2525])
    trimesh.util.concatenate([box, pedestal]).export(tmp_path / "pedestal.stl")
    scene = load_scene(str(tmp_path / "pedestal.stl"))
    assert scene.notes == ()
    assert scene.model.nmeshface == 24


def mushroom():
    """A lamp that stands on its foot, and on no other side."""
    foot = trimesh.creation.cylinder(0.1, 0.02)
    stem = trimesh.creation.cylinder(0.02, 0.5)
    stem.apply_translation([0, 0, 0.26])
    head = trimesh.creation.icosphere(3, 0.15)
    head.apply_translation([0, 0, 0.6])
    return trimesh.util.concatenate([foot, stem, head])


def lying(mesh):
    """Return ``mesh``, whose z axis was up, with y up."""
    turned = mesh.copy()
    turned.vertices = mesh.vertices[:, [0, 2, 1]] * (1, 1, -1)
    return turned


@pytest.mark.parametrize(
    ("mesh", "up", "height", "said"),
    [
        (mushroom(), "auto", 0.76, False),
        (lying(mushroom()), "auto", 0.76, True),
        (lying(mushroom()), "y", 0.76, False),
        (lying(mushroom()), "z", 0.30, False),
        (mushroom(), "y", 0.30, False),
    ],
)
def test_up_is_guessed_where_it_is_not_stated_and_said(tmp_path, mesh, up, height, said):
    mesh.export(tmp_path / "lamp.obj")
    scene = load_scene(str(tmp_path / "lamp.obj"), room="none", mesh_up=up)
    truth = Truth(scene, KinematicWorld(scene.spawn), MujocoCaster(scene.model), lambda: None)
    assert truth.surface(0.02)[0][:, 2].max() == pytest.approx(height, abs=0.02)
    assert any("y axis of the mesh is taken to be up" in note for note in scene.notes) == said


def test_an_axis_that_is_none_is_refused():
    with pytest.raises(ConfigError, match="mesh_up must be auto, y, z; got 'x'"):
        load_scene("three_boxes", mesh_up="x")


def test_all_objects_of_an_obj_file_in_mjcf_are_seen(tmp_path):
    boxes = []
    for y in (-0.4, 0.4):
        box = trimesh.creation.box((0.2, 0.2, 0.5))
        box.apply_translation([0, y, 0.25])
        boxes.append(box)
    lines, count = [], 1
    for number, box in enumerate(boxes):
        lines.append(f"o part{number}")
        lines += [f"v {x} {y} {z}" for x, y, z in box.vertices]
        lines += ["f " + " ".join(str(k + count) for k in face) for face in box.faces]
        count += len(box.vertices)
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "two.obj").write_text("\n".join(lines))
    (tmp_path / "two.xml").write_text(
        '<mujoco><compiler meshdir="assets"/><asset><mesh file="two.obj" scale="1 1 2"/></asset>'
        '<worldbody><site name="spawn" pos="-1.5 0 0"/>'
        '<geom name="target" type="mesh" mesh="two"/></worldbody></mujoco>'
    )
    scene = load_scene(str(tmp_path / "two.xml"))
    assert scene.notes == ("Mesh two: all objects of two.obj are used, not only the first.",)
    origins = np.array([[-1.0, -0.4, 0.7], [-1.0, 0.4, 0.7], [-1.0, 0.0, 0.7]])
    ahead = np.tile([1.0, 0.0, 0.0], (3, 1))
    found = MujocoCaster(scene.model).cast(np.empty(0), origins, ahead).distances
    assert found == pytest.approx([0.9, 0.9, np.inf], abs=1e-6)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\n" + "".join(f"property float {x}\n" for x in "xyz")
PLY_FACE = (
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("list.gltf", '{"asset": {"version": "2.0"}, "meshes": [1]}'),
        ("null.gltf", '{"asset": {"version": "2.0"}, "meshes": null}'),
        ("deep.gltf", "[" * 3000 + "]" * 3000),
        ("infinite.ply", PLY + PLY_FACE + "inf 0 1 2\n"),
        ("negative.ply", PLY + PLY_FACE + "-3 0 1 2\n"),
        ("count.ply", PLY.replace("vertex 3", "vertex -3") + PLY_FACE + "3 0 1 2\n"),
        ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\nv 0 0 1\n"),
    ],
)
def test_damaged_numbers_are_one_line(tmp_path, name, content):
    (tmp_path / name).write_text(content)
    with pytest.raises(SceneError, match=name) as caught:
        read_mesh(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_mesh_of_two_thousand_parts_keeps_all_but_its_plate():
    places = np.stack(np.meshgrid(np.arange(44.0), np.arange(44.0)), axis=-1).reshape(-1, 2) * 0.02
    small = trimesh.creation.box((0.01, 0.01, 0.3))
    parts = [small.copy().apply_translation((x, y, 0.2)) for x, y in places]
    plate = trimesh.creation.box((2.0, 2.0, 0.004)).apply_translation((0.44, 0.44, 0.0))
    whole = trimesh.util.concatenate([*parts, plate])
    faces, notes = drop_surroundings(np.array(whole.vertices), np.array(whole.faces))
    assert len(faces) == 12 * len(parts)
    assert "taken to be the ground" in notes[0]
