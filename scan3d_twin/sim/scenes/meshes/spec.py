"""A mesh file as a scene: its triangles for the rays, small boxes for the contacts.

MuJoCo collides with the convex hull of a mesh, which may contain the robot. So the mesh has no
contacts; invisible boxes cover its surface below the robot's height instead.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.sim.mesh_up import MeshUp
from scan3d_twin.sim.scenes.meshes.cleanup import drop_surroundings, turn_up
from scan3d_twin.sim.scenes.meshes.files import GLTF_SUFFIXES, count_obj_objects, read_mesh
from scan3d_twin.sim.scenes.mjcf.floors import ROBOT_HEIGHT
from scan3d_twin.sim.scenes.surface_samples import sample_triangles
from scan3d_twin.sim.scenes.walls import add_walls

SPAWN_DISTANCE = 1.5
"""Distance from the robot's start to the mesh [m]; as in the built-in scenes."""
START_ROOM = 0.40
"""Least room between the robot's start and the wall behind it [m]: the robot's radius, clearance
and as much again."""
SIZE_LIMITS = (0.02, 20.0)
"""Smallest and largest plausible extent of a mesh [m]; beyond, its unit is wrong."""
GRID_CELLS = 24
"""Cells of the collision grid along the longer side of the footprint."""


def mesh_spec(
    path: Path, scale: float, room: tuple[float, float] | None, up: MeshUp = "auto"
) -> tuple[Any, list[str]]:
    """Return an ``MjSpec`` with the mesh of ``path`` as target, on the floor, 1.5 m ahead of spawn.

    The other result is what was guessed or left out, in sentences.

    The mesh stands in the middle of the room, whose walls move outwards where it leaves the robot
    no way round it.

    Args:
        path: A file of a format of ``MESH_SUFFIXES``.
        scale: Metres per unit of the file.
        room: Width (across the robot's first view) and depth of the room [m]; None for an open
            floor.
        up: The file's axis that is up; auto: y in glTF by definition, else guessed.

    Raises:
        SceneError: The file is not a mesh, is empty, or its size is implausible.
    """
    # Add the mesh for the rays
    vertices, faces, notes = _load(path, scale, up)
    spec = mujoco.MjSpec()
    spec.modelname = path.stem
    spec.add_mesh(
        name="target",
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # open sheets have no volume
    )
    spec.worldbody.add_geom(
        name="target",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="target",
        contype=0,
        conaffinity=0,
        rgba=[0.8, 0.75, 0.6, 1],
    )

    # Add invisible boxes for contacts
    for low, high in _collision_boxes(vertices, faces):
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(low + high) / 2,
            size=(high - low) / 2,
            rgba=[0, 0, 0, 0],  # rays pass fully transparent geoms
            group=3,
        )

    # Add spawn, light and conventions
    spec.worldbody.add_site(
        name="spawn", pos=[vertices[:, 0].min() - SPAWN_DISTANCE, 0, 0], group=4
    )
    spec.worldbody.add_light(pos=[0, 0, 3], dir=[0.3, 0, -1])
    spec.add_text(name="scan3d.tour", data="full")
    place = "on an open floor" if room is None else _add_room(spec, vertices[faces], room)
    x, y, z = np.ptp(vertices, axis=0)
    size = f"{x:.2f} x {y:.2f} x {z:.2f} m high"
    spec.add_text(name="scan3d.description", data=f"mesh {path.name}, {size}, {place}")
    return spec, notes


def complete_obj_meshes(spec: Any) -> list[str]:
    """Give the OBJ meshes of ``spec`` all objects of their files, and say so in sentences.

    MuJoCo (4.0) reads the faces of the first object or group alone, which is what rays would see.

    Raises:
        SceneError: Such a file is damaged.
    """
    notes = []
    for mesh in spec.meshes:
        path = Path(spec.modelfiledir) / spec.meshdir / mesh.file
        if path.suffix.lower() != ".obj" or not path.is_file() or count_obj_objects(path) < 2:
            continue
        vertices, faces = read_mesh(path)
        faces = faces[_areas(vertices, faces) > 0]
        mesh.name = mesh.name or path.stem  # as MuJoCo names it by its file
        mesh.file, mesh.uservert, mesh.userface = "", vertices.ravel(), faces.ravel()
        notes.append(f"Mesh {mesh.name}: all objects of {path.name} are used, not only the first.")
    return notes


def _add_room(spec: Any, triangles: FloatArray, room: tuple[float, float]) -> str:
    """Add a room round the ``triangles`` (m, 3, 3); return its size in words."""
    corners = triangles.reshape(-1, 3)[:, :2]
    width, depth = room
    needed = np.ptp(corners, axis=0) + 2 * (SPAWN_DISTANCE + START_ROOM)
    depth, width = max(depth, float(needed[0])), max(width, float(needed[1]))
    add_walls(spec, (depth / 2, depth / 2, width / 2, width / 2))
    return f"in a room of {width:.3g} x {depth:.3g} m"


def _load(path: Path, scale: float, up: MeshUp) -> tuple[FloatArray, IntArray, list[str]]:
    """Return vertices (n, 3) [m], centred at x = y = 0 and standing on z = 0, and faces (m, 3).

    The last is what was guessed or left out, in sentences.
    """
    # Read the triangles
    vertices, faces = read_mesh(path)
    vertices = vertices * scale
    faces = faces[_areas(vertices, faces) > 0]
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise SceneError(f"{path} holds no triangles; export it as a triangle mesh")

    # Turn it upright, without what does not belong to it
    defined = path.suffix.lower() in GLTF_SUFFIXES
    vertices, guess = turn_up(vertices, faces, up, defined=defined)
    faces, notes = drop_surroundings(vertices, faces)
    notes = [guess, *notes] if guess else notes

    # Put it on the floor
    kept, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[kept], index.reshape(-1, 3)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    largest = float((high - low).max())
    if not SIZE_LIMITS[0] <= largest <= SIZE_LIMITS[1]:
        raise SceneError(
            f"{path} would be {largest:g} m large; give --mesh-scale, such as 0.001 for millimetres"
        )
    middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]
    return vertices - middle, faces, notes


def _areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the areas of the triangles (m,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    areas: FloatArray = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def _collision_boxes(vertices: FloatArray, faces: IntArray) -> list[tuple[FloatArray, FloatArray]]:
    """Return boxes (low, high corner) [m] that cover the surface below the robot's height.

    Only cells that contain surface are covered, so that hollow objects stay hollow.
    """
    # Sample surface below the robot's height
    extent = np.ptp(vertices[:, :2], axis=0)
    cell = max(float(extent.max()) / GRID_CELLS, SIZE_LIMITS[0])
    points, _ = sample_triangles(vertices[faces], cell / 2)
    points = np.concatenate([points, vertices[np.unique(faces)]])
    points = points[points[:, 2] < ROBOT_HEIGHT]
    if len(points) == 0:
        return []

    # Cover the cells with surface
    origin = points[:, :2].min(axis=0)
    cells = ((points[:, :2] - origin) / cell).astype(int)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    return [_box(points, cells, run, origin, cell) for run in _runs(occupied)]


def _runs(occupied: BoolArray) -> list[tuple[int, int, int]]:
    """Return maximal runs (row, first, last + 1) of occupied cells, row by row."""
    padded = np.pad(occupied, ((0, 0), (1, 1))).astype(int)
    rows, starts = np.nonzero(np.diff(padded, axis=1) == 1)
    _, ends = np.nonzero(np.diff(padded, axis=1) == -1)
    return list(zip(rows.tolist(), starts.tolist(), ends.tolist(), strict=True))


def _box(
    points: FloatArray, cells: IntArray, run: tuple[int, int, int], origin: FloatArray, cell: float
) -> tuple[FloatArray, FloatArray]:
    """Return the bounding box of the points in a run of cells, at least 5 mm thick."""
    row, first, end = run
    mask = (cells[:, 0] == row) & (cells[:, 1] >= first) & (cells[:, 1] < end)
    low, high = points[mask].min(axis=0), points[mask].max(axis=0)
    thin = np.maximum(0.0, 0.005 - (high - low)) / 2
    return low - thin, high + thin
