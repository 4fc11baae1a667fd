"""The unit of an exported file: metres, or the millimetres that printers and CAD assume."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from scan3d_twin.core.model.mesh import Mesh

Unit = Literal["m", "mm"]
PER_METRE: dict[Unit, float] = {"m": 1.0, "mm": 1000.0}
NAMES: dict[Unit, str] = {"m": "metres", "mm": "millimetres"}


def mesh_in_unit(mesh: Mesh, unit: Unit) -> Mesh:
    """Return ``mesh``, whose lengths are in metres, with lengths in ``unit``."""
    return mesh if unit == "m" else replace(mesh, vertices=PER_METRE[unit] * mesh.vertices)
