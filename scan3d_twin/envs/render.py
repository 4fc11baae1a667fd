"""Rendering: the top view of an episode as an image, or as coloured text in a terminal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.navigation.costmap import FREE, OBSTACLE, RESOLUTION, Costmap
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray

SIDE = 256
"""Pixels along each side."""
METRES = 6.4
"""Length of each side [m], the target in the middle."""
UNKNOWN_RGB, FREE_RGB, OBSTACLE_RGB = (38, 42, 48), (226, 230, 234), (120, 96, 80)
VIEW_RGB = ((47, 126, 216), (232, 113, 10), (31, 157, 85), (214, 51, 108), (130, 80, 223))
"""Colours of the target's points, cycling through the views."""
PATH_RGB, ROBOT_RGB = (180, 60, 60), (20, 20, 20)
Picture = npt.NDArray[np.uint8]


def draw_picture(session: Session, costmap: Costmap) -> Picture:
    """Return the top view (SIDE, SIDE, 3): costmap, target by view, path and robot."""
    view = session.views[-1]
    T_odom_world = view.observation.T_odom_scan @ view.T_world_scan.inverse()
    middle = T_odom_world.apply(session.hint).mean(axis=0)
    image = _floor(costmap, middle)

    # Target points by view.
    for k, seen in enumerate(session.views):
        pose = T_odom_world @ seen.T_world_scan
        _dot(image, pose.apply(seen.target.points[:, :2]), middle, VIEW_RGB[k % len(VIEW_RGB)], 0)

    # Path between the views.
    places = np.array([[p.x, p.y] for p in (T_odom_world @ v.T_world_scan for v in session.views)])
    for a, b in pairwise(places):
        _dot(image, a + np.linspace(0, 1, 64)[:, None] * (b - a), middle, PATH_RGB, 0)
    _dot(image, places, middle, PATH_RGB, 2)

    # Robot, with its heading.
    here = view.observation.T_odom_scan
    nose = here.apply(np.stack([np.linspace(0, 0.25, 32), np.zeros(32)], axis=1))
    _dot(image, nose, middle, ROBOT_RGB, 1)
    return image


def format_blocks(image: Picture, columns: int = 64) -> str:
    """Return ``image`` (n, n, 3) as text for a terminal: half blocks in 24-bit colours."""
    size = image.shape[0] // columns
    small = image[: size * columns, : size * columns].reshape(columns, size, columns, size, 3)
    pixels = small.mean(axis=(1, 3)).astype(np.int64)
    lines = []
    for upper, lower in zip(pixels[::2], pixels[1::2], strict=True):
        cells = (
            f"\x1b[38;2;{a[0]};{a[1]};{a[2]};48;2;{b[0]};{b[1]};{b[2]}m\u2580"
            for a, b in zip(upper, lower, strict=True)
        )
        lines.append("".join(cells) + "\x1b[0m")
    return "\n".join(lines) + "\n"


def _floor(costmap: Costmap, middle: FloatArray) -> Picture:
    """Return the costmap as seen from above, x to the right and y up."""
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * METRES
    x, y = np.meshgrid(steps, -steps)
    places = middle + np.stack([x, y], axis=-1)
    cells = np.floor((places - costmap.origin) / RESOLUTION).astype(np.int64)
    inside = np.all((cells >= 0) & (cells < costmap.cells.shape), axis=-1)
    image = np.full((SIDE, SIDE, 3), UNKNOWN_RGB, np.uint8)
    known = costmap.cells[cells[inside][:, 0], cells[inside][:, 1]]
    rows = image[inside]
    rows[known == FREE], rows[known == OBSTACLE] = FREE_RGB, OBSTACLE_RGB
    image[inside] = rows
    return image


def _dot(
    image: Picture, points: FloatArray, middle: FloatArray, rgb: tuple[int, int, int], radius: int
) -> None:
    """Draw squares at ``points`` (n, 2) in ``odom`` [m]."""
    column = np.floor((points[:, 0] - middle[0]) / METRES * SIDE + SIDE / 2).astype(np.int64)
    row = np.floor(SIDE / 2 - (points[:, 1] - middle[1]) / METRES * SIDE).astype(np.int64)
    for i in range(-radius, radius + 1):
        for j in range(-radius, radius + 1):
            r, c = row + i, column + j
            inside = (r >= 0) & (r < SIDE) & (c >= 0) & (c < SIDE)
            image[r[inside], c[inside]] = rgb
