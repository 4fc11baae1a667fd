"""What a lidar sees of a scene: one rule for both ray casters and for the truth.

1. What is drawn fully transparent is not there for light: alpha 0 of the colour that MuJoCo draws,
   which is the geom's own where it differs from MuJoCo's default, else its material's.
2. Geoms of the groups 0 to 2, which MuJoCo's viewers draw, are seen; but where a body has visual
   geoms (drawn, without contacts), its geoms with contacts in other groups stand in for them, and
   are not seen: the convention of URDF imports, MuJoCo Menagerie and robosuite. A label
   does not replace the box that it is on: where the bounding box of the visual geoms holds less
   than a quarter of that of a geom with contacts, this one is seen.
3. Geoms of the groups 3 to 5 are not drawn. Those with contacts are seen where nothing drawn stands
   for them: no drawn geom of their body or, as things in the world body do not belong together,
   none whose bounding box meets theirs.
4. A plane is a sheet: seen from both sides, and endless where its size is 0.

Faces of meshes are seen from both sides as well, whichever way they are wound.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

DRAWN_GROUPS = 3
"""Number of geom groups, from 0 on, that MuJoCo's viewers draw by default (mjv_defaultOption)."""
UNSET_RGBA = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour: then the material's counts."""
GROUNDS = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
"""Geom types that things stand on: they stand for nothing else."""
TOUCHING = 0.01
"""Distance of bounding boxes within which what is drawn stands for what is not [m]; assumption."""

STANDS_IN = 0.25
"""Least share of a geom's bounding box inside that of what it stands in for; assumption."""
MIN_EXTENT = 1e-6
"""Least extent of a bounding box [m]."""


def drawn_rgba(model: Any, geom: int) -> FloatArray:
    """Return the colour (4,) in which MuJoCo draws a geom: red, green, blue, alpha."""
    material = model.geom_matid[geom]
    if material >= 0 and np.allclose(model.geom_rgba[geom], UNSET_RGBA):
        return np.array(model.mat_rgba[material], dtype=np.float64)
    return np.array(model.geom_rgba[geom], dtype=np.float64)


def is_visible(model: Any, geom: int) -> bool:
    """Return whether light meets a geom at all: it is not fully transparent."""
    return bool(drawn_rgba(model, geom)[3] > 0)


def find_transparency(model: Any) -> FloatArray:
    """Return the share of light that each geom lets through by its alpha (n_geoms,); 0 is opaque.

    What is fully transparent is not there at all, and has 0 as well.
    """
    alphas = np.array([drawn_rgba(model, geom)[3] for geom in range(model.ngeom)])
    return np.where((alphas > 0) & (alphas < 1), 1 - alphas, 0.0)


def find_seen_geoms(model: Any) -> BoolArray:
    """Return which geoms (n_geoms,) a lidar sees, by the rule above."""
    opaque = np.array([is_visible(model, geom) for geom in range(model.ngeom)], dtype=bool)
    drawn = opaque & (model.geom_group < DRAWN_GROUPS)
    touched = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    seen: BoolArray = drawn.copy()
    hidden = opaque & ~drawn & touched
    if hidden.any():
        seen |= hidden & ~_find_represented(model, hidden, drawn)

    # Visual geoms before those with contacts
    visual = drawn & ~touched
    bodies = np.setdiff1d(
        model.geom_bodyid[visual], [0]
    )  # those of the world do not belong together
    boxes = _bounding_boxes(model) if len(bodies) else None
    for body in bodies:
        of_body = model.geom_bodyid == body
        groups = model.geom_group[of_body & visual]
        doubles = of_body & touched & ~np.isin(model.geom_group, groups)
        if boxes is not None and doubles.any():
            seen &= ~(doubles & (_shares_inside(boxes, of_body & visual) >= STANDS_IN))
    return seen


def find_stand_ins(model: Any, geom: int, seen: BoolArray) -> IntArray:
    """Return the ``seen`` geoms that show what an unseen ``geom`` stands for, maybe none (n,)."""
    same = seen & (model.geom_bodyid == model.geom_bodyid[geom])
    if model.geom_bodyid[geom] == 0:
        boxes = _bounding_boxes(model)
        same &= _do_meet(boxes, geom)
    return np.flatnonzero(same & ~np.isin(model.geom_type, GROUNDS))


def model_as_seen(model: Any, seen: BoolArray | None = None) -> Any:
    """Return a copy of ``model`` whose geoms MuJoCo's rays hit where ``seen``, and no others.

    Without ``seen``, what the rule above says.
    """
    seen = find_seen_geoms(model) if seen is None else seen
    result = copy.copy(model)
    result.geom_matid[:] = -1  # rays pass what has alpha 0, by the material where there is one
    result.geom_rgba[:] = UNSET_RGBA
    result.geom_rgba[~seen, 3] = 0.0
    result.geom_group[:] = 0
    return result


def _find_represented(model: Any, hidden: BoolArray, drawn: BoolArray) -> BoolArray:
    """Return which of the ``hidden`` geoms (n_geoms,) something ``drawn`` stands for."""
    represented = np.isin(model.geom_bodyid, np.unique(model.geom_bodyid[drawn]))
    solid = drawn & (model.geom_bodyid == 0) & ~np.isin(model.geom_type, GROUNDS)
    boxes = _bounding_boxes(model)
    for geom in np.flatnonzero(hidden & (model.geom_bodyid == 0)):
        represented[geom] = bool((solid & _do_meet(boxes, int(geom))).any())
    return np.asarray(represented)


def _bounding_boxes(model: Any) -> tuple[FloatArray, FloatArray]:
    """Return the low and high corners (n_geoms, 3) [m] of the geoms, in ``map``."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rotations = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + np.einsum("nij,nj->ni", rotations, model.geom_aabb[:, :3])
    half = np.einsum("nij,nj->ni", np.abs(rotations), model.geom_aabb[:, 3:])
    return middle - half, middle + half


def _shares_inside(boxes: tuple[FloatArray, FloatArray], which: BoolArray) -> FloatArray:
    """Return the share (n_geoms,) of each box that lies in the box around ``which`` of them."""
    low, high = boxes
    first, last = low[which].min(axis=0) - TOUCHING, high[which].max(axis=0) + TOUCHING
    inside = np.minimum(high, last) - np.maximum(low, first)
    extent = np.maximum(high - low, MIN_EXTENT)
    shares: FloatArray = np.clip((inside + MIN_EXTENT) / extent, 0.0, 1.0).prod(axis=1)
    return shares


def _do_meet(boxes: tuple[FloatArray, FloatArray], geom: int) -> BoolArray:
    """Return which boxes (n_geoms,) are within ``TOUCHING`` of that of ``geom``."""
    low, high = boxes
    near = (low <= high[geom] + TOUCHING) & (high >= low[geom] - TOUCHING)
    return np.asarray(near.all(axis=1))


def choose_seen_parts(
    model: Any, targets: Mapping[str, tuple[str, ...]], label: str
) -> dict[str, tuple[str, ...]]:
    """Return the names of each target's geoms that a lidar sees, so that the truth is what it sees.

    A geom that stands in for others is replaced by these.

    Args:
        model: The compiled scene.
        targets: Names of the geoms of each target; geoms to be replaced must have names.
        label: The scene in messages.

    Raises:
        SceneError: A lidar sees nothing of a target.
    """
    seen = find_seen_geoms(model)
    result = {}
    for target, names in targets.items():
        # Collect seen geoms, and those behind stand-ins
        parts: list[int] = []
        for name in names:
            geom = model.geom(name).id
            parts += [geom] if seen[geom] else find_stand_ins(model, geom, seen).tolist()
        found = tuple(dict.fromkeys(model.geom(part).name for part in parts))
        if not found:
            raise SceneError(
                f"{label}: the lidar sees nothing of target {target!r}: it is fully transparent, "
                "or neither drawn (geom groups 0 to 2) nor touched; give it alpha or a group"
            )
        result[target] = found
    return result
