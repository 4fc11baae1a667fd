"""Mesh files of all formats as vertices and triangles, or an error that names what is not read."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.sim.scenes.meshes.ply_file import read_ply
from scan3d_twin.sim.scenes.meshes.polygons import check_indices, triangulate

MESH_SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".gltf", ".off")
"""Formats that are read."""
GLTF_SUFFIXES = (".glb", ".gltf")
"""Formats whose y axis is up by definition (glTF 2.0, section 3.4)."""
OTHER_SUFFIXES = (
    *(".3dm", ".3ds", ".3mf", ".abc", ".amf", ".blend", ".brep", ".ctm", ".dae", ".dxf", ".fbx"),
    *(".iges", ".igs", ".iv", ".jt", ".ma", ".max", ".mb", ".mjb", ".msh", ".pcd"),
    *(".sdf", ".skp", ".sldprt", ".step", ".stp", ".urdf", ".usd", ".usda", ".usdc", ".usdz"),
    *(".vrml", ".vtk", ".vtp", ".wrl", ".x", ".x3d", ".x_t", ".xyz"),
)
"""Formats that are known and not read."""
HARMLESS_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_xmp")
"""Beginnings of the names of glTF extensions that do not change the geometry."""
QUANTIZATION = "KHR_mesh_quantization"
INSTANCING = "EXT_mesh_gpu_instancing"
TRIANGLE_FAN, FIRST_TRIANGLE_MODE = 6, 4
"""Modes of glTF primitives (section 3.7.2.1): points and lines come before triangles."""


def refuse_other_format(path: Path) -> None:
    """Refuse a file that is none of ``MESH_SUFFIXES`` nor MJCF, by the name of its format.

    Raises:
        SceneError: It is such a file.
    """
    suffix = path.suffix.lower()
    if suffix in OTHER_SUFFIXES or (suffix and path.is_file()):
        known = ", ".join(MESH_SUFFIXES)
        raise SceneError(f"{path}: files of type {suffix} are not read; export as one of {known}")


def read_mesh(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices (n, 3) of a file, in its own units and axes, and its triangles (m, 3).

    Raises:
        SceneError: It is damaged, empty, or holds what is not read.
    """
    suffix = path.suffix.lower()
    try:
        if suffix in GLTF_SUFFIXES:
            _check_gltf(path)
        if suffix == ".ply":
            vertices, faces = read_ply(path)
        elif suffix == ".obj":
            vertices, faces = read_obj(path)
        elif suffix == ".off":
            vertices, faces = _read_off(path)
        else:
            vertices, faces = _read_by_trimesh(path)
    except OSError as error:
        raise SceneError(f"{path} cannot be read: {error.strerror}") from None
    check_indices(faces.ravel(), len(vertices), str(path))
    return vertices, faces


def read_obj(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices and triangles of all objects and groups of a Wavefront OBJ file."""
    # Read vertices and faces, counting from the end where an index is negative
    vertices: list[list[float]] = []
    polygons = []
    text = path.read_text(encoding="latin-1").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        try:
            if not words or words[0] not in ("v", "f", "curv", "surf"):
                continue
            if words[0] == "v":
                vertices.append([float(word) for word in words[1:4]])
            elif words[0] == "f":
                corners = [int(word.split("/", 1)[0]) for word in words[1:]]
                if 0 in corners:
                    raise ValueError("indices begin with 1")
                count = len(vertices)
                polygons.append([k - 1 if k > 0 else count + k for k in corners])
            else:
                raise SceneError(f"{path} holds free-form curves or surfaces; export polygons")
        except ValueError:
            raise SceneError(f"{path}: line {number}, {line[:40]!r}, is no OBJ") from None

    # Return them as arrays
    try:
        points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    except ValueError:
        raise SceneError(f"{path} is damaged: a vertex has fewer than 3 coordinates") from None
    return points, triangulate(points, polygons, str(path)) if polygons else _no_faces()


def count_obj_objects(path: Path) -> int:
    """Return how many objects and groups with faces an OBJ file has."""
    count, begun = 0, True
    for line in path.read_text(encoding="latin-1").splitlines():
        begun = begun or line.startswith(("o ", "g "))
        if begun and line.startswith("f "):
            count, begun = count + 1, False
    return count


def _read_off(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices and triangles of an OFF file (Geomview): text, x y z first in a row."""
    try:
        text = path.read_text(encoding="ascii")
        lines = [line.split("#", 1)[0].split() for line in text.splitlines()]
        lines = [words for words in lines if words]
        head = lines.pop(0)
        if not head[0].endswith("OFF") or "4" in head[0] or "n" in head[0]:
            raise SceneError(f"{path}: only three-dimensional OFF files as text are read")
        counts = head[1:] or lines.pop(0)
        n, m = int(counts[0]), int(counts[1])
        vertices = np.array([words[:3] for words in lines[:n]], dtype=np.float64).reshape(-1, 3)
        polygons = [[int(k) for k in words[1 : 1 + int(words[0])]] for words in lines[n : n + m]]
        stated = [int(words[0]) for words in lines[n : n + m]]
        if len(polygons) < m or stated != [len(polygon) for polygon in polygons]:
            raise IndexError
    except (ValueError, IndexError):
        raise SceneError(f"{path} is damaged or no OFF file as text; export it again") from None
    return vertices, triangulate(vertices, polygons, str(path)) if polygons else _no_faces()


def _no_faces() -> IntArray:
    return np.empty((0, 3), np.int64)


def _read_by_trimesh(path: Path) -> tuple[FloatArray, IntArray]:
    """Return the vertices and triangles of an STL or glTF file."""
    import trimesh  # slow to import, and only meshes need it

    try:
        mesh = trimesh.load_mesh(path)
        vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    except Exception as error:  # noqa: BLE001 - each of trimesh's decoders fails in its own way
        reason = " ".join(str(error).split()) or type(error).__name__
        raise SceneError(f"{path} is not a mesh that can be read: {reason}") from None
    return (vertices, faces) if path.suffix.lower() in GLTF_SUFFIXES else _number(vertices, faces)


def _number(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """Return ``vertices`` (n, 3) in the order of their places, and ``faces`` (m, 3) of them.

    An STL file has no numbers of its own; those by which its faces come vary with their winding.
    """
    order = np.lexsort(vertices.T[::-1])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    return vertices[order], number[faces]


def _check_gltf(path: Path) -> None:
    """Refuse by name what is not read of a glTF 2.0 file.

    Raises:
        SceneError: Its geometry needs an extension, or a kind of primitive, that is not read.
    """
    try:
        _check_tree(path, _gltf_tree(path))
    except (AttributeError, TypeError, KeyError, IndexError, RecursionError):
        raise SceneError(f"{path} is damaged: it is no glTF") from None


def _check_tree(path: Path, tree: dict[str, Any]) -> None:
    """Refuse what is not read of the JSON part ``tree`` of a glTF file."""
    required = {str(name) for name in tree.get("extensionsRequired", ())}
    used = {str(name) for name in tree.get("extensionsUsed", ())}
    unread = [name for name in sorted(required) if not name.startswith(HARMLESS_EXTENSIONS)]
    unread = [name for name in unread if name != QUANTIZATION] + sorted(used & {INSTANCING})
    if unread:
        raise SceneError(
            f"{path} needs the glTF extension {unread[0]}, which is not read; export it without "
            "compression and instances"
        )
    accessors = tree.get("accessors", ())
    for mesh in tree.get("meshes", ()):
        for part in mesh.get("primitives", ()):
            place = part.get("attributes", {}).get("POSITION")
            accessor = accessors[place] if isinstance(place, int) and place < len(accessors) else {}
            _check_primitive(path, part.get("mode", FIRST_TRIANGLE_MODE), accessor)


def _check_primitive(path: Path, mode: int, accessor: dict[str, Any]) -> None:
    """Refuse a primitive of an unread ``mode`` or ``accessor`` of positions."""
    what = ""
    if mode == TRIANGLE_FAN:
        what = "triangle fans"
    elif mode >= FIRST_TRIANGLE_MODE and accessor.get("normalized"):
        what = f"normalised positions ({QUANTIZATION})"
    elif mode >= FIRST_TRIANGLE_MODE and "sparse" in accessor:
        what = "sparse positions"
    if what:
        raise SceneError(f"{path} holds {what}, which are not read; export plain triangles")


def _gltf_tree(path: Path) -> dict[str, Any]:
    """Return the JSON part of a glTF file."""
    data = path.read_bytes()
    if data[:4] == b"glTF":
        if len(data) < 20:
            raise SceneError(f"{path} is damaged: it ends early")
        version, _, length = struct.unpack("<3I", data[4:16])
        if version != 2:
            raise SceneError(f"{path} is of glTF {version}; only glTF 2 is read")
        data = data[20 : 20 + length]
    try:
        tree = json.loads(data)
    except ValueError:
        raise SceneError(f"{path} is damaged: it is no glTF") from None
    if not isinstance(tree, dict):
        raise SceneError(f"{path} is damaged: it is no glTF")
    return tree
