"""What a mesh file holds besides the thing: loose specks, a ground plate; and which side is up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.sim.mesh_up import MeshUp
from scan3d_twin.sim.scenes.orientation import weld

SPECK_AREA = 1e-3
"""Share of the surface below which a loose part is a speck (assumption)."""
SPECK_GAP = 0.25
"""Distance of a speck from the rest, in units of the rest's extent: nearer ones may belong to it
(assumption)."""
PLATE_THICKNESS = 0.02
"""Thickness of a ground plate in units of its width (assumption)."""
PLATE_WIDTH = 1.5
"""Width of a ground plate in units of that of what stands on it (assumption): a pedestal is
narrower."""
FOOT_HEIGHT = 0.01
"""Height of the foot of a thing, in units of its height (assumption)."""

MAX_PARTS = 2000
"""Most parts that are looked at: more are a soup of triangles."""


@dataclass(frozen=True)
class Part:
    """A loose part of a mesh: number, low and high corner (3,) [m], and area [m2]."""

    number: int
    low: FloatArray
    high: FloatArray
    area: float


def turn_up(
    vertices: FloatArray, faces: IntArray, up: MeshUp, *, defined: bool
) -> tuple[FloatArray, str]:
    """Return ``vertices`` (n, 3) with z up, and a sentence if that was guessed.

    Args:
        vertices: In the file's axes.
        faces: Its triangles (m, 3).
        up: The axis that is up.
        defined: Whether the file's format defines that y is up.
    """
    note = ""
    if up == "auto" and defined:
        up = "y"
    elif up == "auto":
        up = "z"
        if not _does_stand(vertices, faces, 2) and _does_stand(vertices, faces, 1):
            up = "y"
            note = (
                "The y axis of the mesh is taken to be up, as it would not stand with z up; "
                "--mesh-up z if that is wrong."
            )
    return (vertices[:, [0, 2, 1]] * (1, -1, 1) if up == "y" else vertices), note


def _does_stand(vertices: FloatArray, faces: IntArray, axis: int) -> bool:
    """Return whether the surface's centre is above the foot of a thing whose ``axis`` is up."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import

    triangles = vertices[faces]
    areas = _areas(triangles)
    centre = (areas[:, None] * triangles.mean(axis=1)).sum(axis=0) / areas.sum()
    points = triangles.reshape(-1, 3)
    heights = points[:, axis]
    foot = points[heights <= heights.min() + FOOT_HEIGHT * np.ptp(heights)]
    others = [k for k in range(3) if k != axis]
    try:
        sides = ConvexHull(foot[:, others]).equations
    except (QhullError, ValueError):  # a foot without width: a ball, a blade
        return False
    return bool((sides[:, :2] @ centre[others] + sides[:, 2] <= 0).all())


def drop_surroundings(vertices: FloatArray, faces: IntArray) -> tuple[IntArray, list[str]]:
    """Return ``faces`` without loose specks far off and without a ground plate, and what was left.

    Args:
        vertices: With z up (n, 3).
        faces: Triangles of some area (m, 3).
    """
    parts, numbers = _find_parts(vertices[faces])
    if len(parts) < 2:
        return faces, []
    notes = []

    # Drop specks far from the rest
    limit = SPECK_AREA * sum(part.area for part in parts)
    things = [part for part in parts if part.area >= limit]
    low = np.min([thing.low for thing in things], axis=0)
    high = np.max([thing.high for thing in things], axis=0)
    specks = [part for part in parts if part.area < limit and _is_far(part, low, high)]
    dropped = np.isin(numbers, [part.number for part in specks])
    if specks:
        notes.append(
            f"{len(specks)} loose speck(s) far from the rest of the mesh were left out "
            f"({int(dropped.sum())} of {len(faces)} faces)."
        )

    # Drop a plate below all the rest
    left_out = {part.number for part in specks}
    plate = _find_plate([part for part in parts if part.number not in left_out])
    if plate is not None:
        dropped |= numbers == plate.number
        width, depth = plate.high[0] - plate.low[0], plate.high[1] - plate.low[1]
        notes.append(
            f"A plate of {width:.3g} x {depth:.3g} m below the mesh is taken "
            "to be the ground and was left out."
        )
    return faces[~dropped], notes


def _find_parts(triangles: FloatArray) -> tuple[list[Part], IntArray]:
    """Return the parts of ``triangles`` (m, 3, 3) that share no vertices, and each one's (m,).

    No parts where there are too many.
    """
    from scipy.sparse import coo_array  # slow to import
    from scipy.sparse.csgraph import connected_components

    corners = weld(triangles)
    m, n = len(corners), int(corners.max()) + 1
    graph = coo_array(
        (np.ones(3 * m, bool), (np.repeat(np.arange(m), 3), m + corners.ravel())),
        shape=(m + n, m + n),
    )
    _, labels = np.unique(connected_components(graph, directed=False)[1][:m], return_inverse=True)
    areas = np.bincount(labels, _areas(triangles))
    if len(areas) > MAX_PARTS:
        return [], labels
    lows = np.full((len(areas), 3), np.inf)
    highs = -lows
    np.minimum.at(lows, labels, triangles.min(axis=1))
    np.maximum.at(highs, labels, triangles.max(axis=1))
    parts = [Part(k, lows[k], highs[k], float(areas[k])) for k in range(len(areas))]
    return parts, labels


def _is_far(part: Part, low: FloatArray, high: FloatArray) -> bool:
    """Return whether a ``part`` is far from the box of ``low`` and ``high`` corner (3,) [m]."""
    gap = np.linalg.norm(np.maximum(0.0, np.maximum(low - part.high, part.low - high)))
    return bool(gap > SPECK_GAP * (high - low).max())


def _find_plate(parts: list[Part]) -> Part | None:
    """Return the part that lies below all others as their ground, if there is one."""
    lowest = min((part.low[2] for part in parts), default=0.0)
    for part in (each for each in parts if each.low[2] == lowest):
        others = [other for other in parts if other is not part]
        if not others:
            return None
        low = np.min([other.low for other in others], axis=0)
        high = np.max([other.high for other in others], axis=0)
        size, rest = part.high - part.low, high - low
        flat = size[2] <= PLATE_THICKNESS * size[:2].min()
        wide = (size[:2] >= PLATE_WIDTH * rest[:2]).all()
        around = (part.low[:2] <= low[:2]).all() and (part.high[:2] >= high[:2]).all()
        below = part.low[2] <= low[2] and part.high[2] <= low[2] + size[:2].max() * PLATE_THICKNESS
        if flat and wide and around and below:
            return part
    return None


def _areas(triangles: FloatArray) -> FloatArray:
    """Return the areas (m,) of ``triangles`` (m, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    areas: FloatArray = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas
