"""Objects for ``objects.py``: closed meshes of six classes, one for each index, and named cases.

``make_object(index)`` gives the same mesh always. The classes take turns; heights are spread
evenly over the logarithm from 0.1 to 1.6 m. All meshes are closed, with outward faces; where a
mesh is made of several bodies, these overlap, and what is inside of another body is never seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import trimesh

from scan3d_twin.core.types import FloatArray

Mesh = trimesh.Trimesh
Box = tuple[Sequence[float], Sequence[float]]
"""Lowest and highest corner [m]."""

HEIGHTS = (0.10, 1.60)
"""Range of heights [m]."""
WIDTHS = (0.12, 1.20)
"""Range of widths and depths [m]: the robot sees them from its standoff in a few views."""
THICKNESS = (0.02, 0.05)
"""Range of the thickness of legs and handles [m]: of a chair, of a table."""
RELIEF = (0.005, 0.030)
"""Range of the depth of a relief [m]: half to three times the noise of a reading."""
STREAM = 20
"""Separates these draws from those of scenes and runs."""


def make_object(index: int) -> tuple[str, Mesh]:
    """Return the name of the class and the mesh [m] of object ``index``, standing on z = 0."""
    name = tuple(CLASSES)[index % len(CLASSES)]
    rng = np.random.default_rng([index, STREAM])

    # Draw the size
    low, high = np.log(HEIGHTS)
    turn = index // len(CLASSES)  # a low-discrepancy sequence spreads the heights of each class
    share = (turn * 0.618034 + 0.381966 * (index % len(CLASSES)) + 0.25) % 1.0
    height = float(np.exp(low + share * (high - low)))
    width, depth = np.clip(height * rng.uniform(0.4, 1.2, 2), *WIDTHS)

    # Build it and turn it
    mesh = CLASSES[name](rng, np.array([depth, width, height]))
    mesh.apply_transform(
        trimesh.transformations.rotation_matrix(rng.uniform(0, math.tau), [0, 0, 1])
    )
    return name, place_on_floor(mesh)


def place_on_floor(mesh: Mesh) -> Mesh:
    """Return ``mesh``, moved to the middle of the floor."""
    low, high = mesh.bounds
    mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    return mesh


def join_boxes(boxes: Iterable[Box]) -> Mesh:
    """Return the surface of the union of axis-parallel ``boxes``.

    The planes of all faces cut space into cells; the surface lies between filled and empty ones.
    """
    # Fill the cells
    corners = np.array([(low, high) for low, high in boxes], dtype=np.float64)
    planes = [np.unique(np.round(corners[:, :, axis], 6)) for axis in range(3)]
    filled = np.zeros([len(each) + 1 for each in planes], dtype=bool)
    for low, high in np.round(corners, 6):
        span = [
            slice(int(np.searchsorted(p, a)) + 1, int(np.searchsorted(p, b)) + 1)
            for p, a, b in zip(planes, low, high, strict=True)
        ]
        filled[tuple(span)] = True

    # Make two triangles of each face between full and empty
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        before, after = np.moveaxis(filled, axis, 0)[:-1], np.moveaxis(filled, axis, 0)[1:]
        moved = [k for k in range(3) if k != axis]
        for k, i, j in np.argwhere(before != after):
            cell = {moved[0]: i, moved[1]: j}
            square = np.zeros((4, 3))
            square[:, axis] = planes[axis][k]
            square[:, u] = planes[u][np.array([0, 1, 1, 0]) + cell[u] - 1]
            square[:, v] = planes[v][np.array([0, 0, 1, 1]) + cell[v] - 1]
            outward = square if before[k, i, j] else square[::-1]
            triangles += [outward[[0, 1, 2]], outward[[0, 2, 3]]]
    return Mesh(**trimesh.triangles.to_kwargs(np.array(triangles)), process=True)


def smooth_blob(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return a ball with a dozen smooth bumps, scaled to ``size``, its bottom flattened."""
    mesh = trimesh.creation.icosphere(4)
    radius = np.ones(len(mesh.vertices))
    for direction in rng.standard_normal((12, 3)):
        cosine = mesh.vertices @ (direction / np.linalg.norm(direction))
        radius += rng.uniform(-0.15, 0.25) * np.exp(4.0 * (cosine - 1.0))
    vertices = mesh.vertices * radius[:, None]
    vertices[:, 2] = np.maximum(vertices[:, 2], -0.75)
    vertices *= size / np.ptp(vertices, axis=0)
    return Mesh(vertices, mesh.faces)


def concave_with_holes(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return an upright torus, a window frame, a gate or a hollow block open to two sides."""
    depth, width, height = size
    bar = max(0.04, 0.15 * min(width, height))
    match int(rng.integers(4)):
        case 0:
            mesh = trimesh.creation.torus(0.7, 0.3)
            mesh.apply_transform(trimesh.transformations.rotation_matrix(math.pi / 2, [0, 1, 0]))
            mesh.apply_scale((min(depth, 0.6 * height), width, height) / np.ptp(mesh.vertices, 0))
            return mesh
        case 1:
            sill = bar + rng.uniform(0.2, 0.5) * (height - 2 * bar)
            boxes = [
                ((0, 0, 0), (bar, width, bar)), ((0, 0, height - bar), (bar, width, height)),
                ((0, 0, 0), (bar, bar, height)), ((0, width - bar, 0), (bar, width, height)),
                ((0, 0, sill - bar / 2), (bar, width, sill + bar / 2)),
            ]  # fmt: skip
        case 2:
            boxes = [
                ((0, 0, 0), (depth, bar, height)), ((0, width - bar, 0), (depth, width, height)),
                ((0, 0, height - bar), (depth, width, height)),
                ((depth - bar, 0, 0), (depth, width, 0.4 * height)),
            ]  # fmt: skip
        case _:
            boxes = [
                ((0, 0, 0), (depth, width, bar)), ((0, 0, height - bar), (depth, width, height)),
                ((0, 0, 0), (bar, bar, height)), ((0, width - bar, 0), (bar, width, height)),
                ((depth - bar, 0, 0), (depth, width, height)),
            ]  # fmt: skip
    return join_boxes(boxes)


def thin(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return a table, a chair, a rack or a basket with a handle."""
    depth, width, height = np.maximum(size, (0.15, 0.15, 0.10))
    leg = float(np.clip(0.06 * height, *THICKNESS))
    match int(rng.integers(4)):
        case 0:
            return table((depth, width, height), leg)
        case 1:
            return chair((depth, width, height), leg)
        case 2:
            shelves = [(z, z + leg) for z in np.linspace(0.15, 1.0, 3) * height - leg]
            boards = [((0, 0, a), (depth, width, b)) for a, b in shelves]
            return join_boxes([*boards, *legs(depth, width, height, leg)])
        case _:
            wall, rim = leg, 0.6 * height
            sides = [
                ((0, 0, 0), (depth, width, wall)),
                ((0, 0, 0), (wall, width, rim)), ((depth - wall, 0, 0), (depth, width, rim)),
                ((0, 0, 0), (depth, wall, rim)), ((0, width - wall, 0), (depth, width, rim)),
            ]  # fmt: skip
            middle = (depth / 2 - leg / 2, depth / 2 + leg / 2)
            handle = [
                ((middle[0], 0, 0), (middle[1], wall, height)),
                ((middle[0], width - wall, 0), (middle[1], width, height)),
                ((middle[0], 0, height - leg), (middle[1], width, height)),
            ]
            return join_boxes([*sides, *handle])


def legs(depth: float, width: float, height: float, leg: float) -> list[Box]:
    """Return four legs at the corners of a footprint."""
    return [
        ((x, y, 0.0), (x + leg, y + leg, height))
        for x in (0, depth - leg)
        for y in (0, width - leg)
    ]


def table(size: Sequence[float], leg: float) -> Mesh:
    """Return a table of ``size`` (depth, width, height), its ``leg`` [m] thick."""
    depth, width, height = size
    return join_boxes(
        [((0, 0, height - leg), (depth, width, height)), *legs(depth, width, height, leg)]
    )


def chair(size: Sequence[float], leg: float) -> Mesh:
    """Return a chair whose seat is at half its height."""
    depth, width, height = size
    seat = 0.5 * height
    return join_boxes(
        [
            ((0, 0, seat - leg), (depth, width, seat)),
            *legs(depth, width, seat, leg),
            ((depth - leg, 0, 0), (depth, leg, height)),
            ((depth - leg, width - leg, 0), (depth, width, height)),
            ((depth - leg, 0, 0.75 * height), (depth, width, height)),
        ]
    )


def flat_faces(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return a tapered prism of three to seven sides, with a box beside every second one."""
    sides = int(rng.integers(3, 8))
    angles = math.tau * (np.arange(sides) + rng.uniform(-0.2, 0.2, sides)) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    taper = rng.uniform(0.5, 1.0)
    vertices = np.concatenate(
        [np.column_stack([ring, np.zeros(sides)]), np.column_stack([taper * ring, np.ones(sides)])]
    )
    prism = trimesh.convex.convex_hull(vertices)
    prism.apply_scale(size / np.ptp(prism.vertices, axis=0))
    if rng.integers(2):
        return prism
    low, high = prism.bounds
    box = trimesh.creation.box((high - low) * (0.5, 0.5, 0.5))
    box.apply_translation([high[0], 0.0, 0.25 * size[2]])
    both: Mesh = trimesh.util.concatenate([prism, box])
    both.apply_scale(size / np.ptp(both.vertices, axis=0))
    return both


def low_relief(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return a slab whose two large sides have a shallow relief of a few waves."""
    _, width, height = size
    thickness = max(0.08, 0.2 * width)
    across, up = max(8, round(width / 0.02)), max(8, round(height / 0.02))
    deep = rng.uniform(*RELIEF)

    # Raise both sides of a slab of small squares
    slab = join_grid(across, up)
    y, z = slab.vertices[:, 1], slab.vertices[:, 2]
    relief = np.zeros((2, len(y)))
    for side in relief:
        for _ in range(4):
            waves, phase = rng.uniform(0.5, 3.0, 2), rng.uniform(0, math.tau, 2)
            side += np.sin(math.tau * waves[0] * y + phase[0]) * np.sin(
                math.tau * waves[1] * z + phase[1]
            )
    relief *= deep / np.ptp(relief)
    front = slab.vertices[:, 0] < 0.5
    x = np.where(front, -relief[0], thickness + relief[1])
    return Mesh(np.column_stack([x, width * y, height * z]), slab.faces)


def join_grid(across: int, up: int) -> Mesh:
    """Return a unit cube whose sides at x = 0 and 1 are grids of ``across`` by ``up`` squares."""
    # Number the vertices of both sides
    y, z = np.meshgrid(np.linspace(0, 1, across + 1), np.linspace(0, 1, up + 1), indexing="ij")
    sides = [np.column_stack([np.full(y.size, x), y.ravel(), z.ravel()]) for x in (0.0, 1.0)]
    index = np.arange(y.size).reshape(y.shape)

    # Triangulate them, and join their borders
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    back = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    border = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    following = np.roll(border, -1)
    rim = np.concatenate(
        [
            np.stack([border, following, following + y.size], 1),
            np.stack([border, following + y.size, border + y.size], 1),
        ]
    )
    faces = np.concatenate([back[:, ::-1], back + y.size, rim])
    return Mesh(np.concatenate(sides), faces, process=False)


def revolution(rng: np.random.Generator, size: FloatArray) -> Mesh:
    """Return a vase: a smooth profile, turned about a vertical axis."""
    radius, height = min(size[0], size[1]) / 2, size[2]
    z = np.linspace(0.0, 1.0, 24)
    profile = 0.75 + 0.25 * np.sin(math.tau * (rng.uniform(0.3, 1.2) * z + rng.uniform()))
    outline = np.column_stack([radius * profile, height * z])
    closed = np.concatenate([[(0.0, 0.0)], outline, [(0.0, height)]])
    return trimesh.creation.revolve(closed, sections=96)


CLASSES: dict[str, Callable[[np.random.Generator, FloatArray], Mesh]] = {
    "smooth_blob": smooth_blob,
    "concave_with_holes": concave_with_holes,
    "thin": thin,
    "flat_faces": flat_faces,
    "low_relief": low_relief,
    "revolution": revolution,
}


def bookshelf() -> Mesh:
    """Return a bookshelf of 0.8 m by 1.6 m, open to the front."""
    depth, width, height, board = 0.30, 0.80, 1.60, 0.02
    shelves = [((0, 0, z), (depth, width, z + board)) for z in np.linspace(0, height - board, 5)]
    return join_boxes(
        [
            *shelves,
            ((0, 0, 0), (depth, board, height)),
            ((0, width - board, 0), (depth, width, height)),
            ((depth - board, 0, 0), (depth, width, height)),
        ]
    )


def turned_box(depth: float, width: float, height: float, degrees: float) -> Mesh:
    """Return a box, turned about the vertical."""
    mesh = trimesh.creation.box((depth, width, height))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(math.radians(degrees), [0, 0, 1]))
    return mesh


MESH_CASES: dict[str, Callable[[], Mesh]] = {
    "height_0.1": lambda: turned_box(0.35, 0.45, 0.1, 20.0),
    "height_0.5": lambda: turned_box(0.35, 0.45, 0.5, 20.0),
    "height_1.0": lambda: turned_box(0.35, 0.45, 1.0, 20.0),
    "height_1.6": lambda: turned_box(0.35, 0.45, 1.6, 20.0),
    "width_3": lambda: turned_box(0.40, 3.00, 0.6, 0.0),
    "table": lambda: table((0.60, 0.90, 0.72), 0.04),
    "chair": lambda: chair((0.45, 0.45, 0.90), 0.03),
    "bookshelf": bookshelf,
    "pole": lambda: trimesh.creation.cylinder(0.015, 1.20, sections=48),
}
"""Single things that must work, by name."""
