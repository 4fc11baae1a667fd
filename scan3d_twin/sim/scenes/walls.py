"""The four walls of a room round a target: surroundings that registration can hold on to."""

from __future__ import annotations

from typing import Any

import mujoco

from scan3d_twin.core.types import FloatArray

WALL_HALF_HEIGHT, WALL_HALF_THICKNESS = 1.25, 0.05
"""Half height and half thickness of walls [m]; as in the built-in scenes."""


def add_walls(spec: Any, limits: FloatArray | tuple[float, float, float, float]) -> None:
    """Add the four walls of a room to ``spec``.

    Args:
        spec: The scene's ``MjSpec``.
        limits: Distances of the walls' inner sides from the origin of ``map``: behind (-x), ahead
            (+x), to the right (-y) and to the left (+y) [m].
    """
    material = spec.add_material(name="wall", rgba=(0.85, 0.85, 0.82, 1.0)).name
    middle = ((limits[1] - limits[0]) / 2, (limits[3] - limits[2]) / 2)
    half = ((limits[0] + limits[1]) / 2, (limits[2] + limits[3]) / 2)
    across = (WALL_HALF_THICKNESS, half[1] + 2 * WALL_HALF_THICKNESS)
    along = (half[0], WALL_HALF_THICKNESS)
    for name, x, y, size in (
        ("back", -limits[0] - WALL_HALF_THICKNESS, middle[1], across),
        ("front", limits[1] + WALL_HALF_THICKNESS, middle[1], across),
        ("right", middle[0], -limits[2] - WALL_HALF_THICKNESS, along),
        ("left", middle[0], limits[3] + WALL_HALF_THICKNESS, along),
    ):
        spec.worldbody.add_geom(
            name=f"wall_{name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, WALL_HALF_HEIGHT),
            size=(*size, WALL_HALF_HEIGHT),
            material=material,
        )
