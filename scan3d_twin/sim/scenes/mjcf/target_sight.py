"""How much of the target is hidden by other things from a place on the floor."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.config import TargetConfig
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.sim.ray_casting import choose_caster
from scan3d_twin.sim.scenes.surface_samples import bounding_points, sample_geom
from scan3d_twin.sim.scenes.visibility import find_transparency

WINDOW = TargetConfig().window
"""Vertical field of view in which a target is looked for [rad]."""
MAX_AIMS = 200
"""About how many points of the target are looked at."""
STEPS = 8
"""Number of samples along the diagonal of the target; 100 to 200 on a box."""
BATCH = 64
"""Number of places whose rays are cast together."""


class TargetSight:
    """Rays of the lidar to points on the target's surface.

    Glass hides nothing, as in coverage, unless it is of the target. What is higher than the window
    in which a run looks for its target counts as hidden.
    """

    def __init__(self, model: Any, targets: tuple[str, ...]) -> None:
        """Look at the geoms ``targets`` of ``model`` in its reference pose."""
        self._model = model
        self._targets = [model.geom(target).id for target in targets]
        self._aims = _aims(model, self._targets)
        self._caster = choose_caster(_without_glass(model, self._targets))

    def shares(self, places: FloatArray) -> FloatArray:
        """Return the share (n,) of rays from ``places`` (n, 2) [m] that end on the target.

        Towards far sides they end on near ones; the other rays end on what hides the target.
        """
        parts = [np.zeros(0)]
        for k in range(0, len(places), BATCH):
            geoms, elevations = self._look(places[k : k + BATCH])
            shown = np.isin(geoms, self._targets) & (np.abs(elevations) <= WINDOW / 2)
            parts.append(shown.reshape(-1, len(self._aims)).mean(axis=1))
        return np.concatenate(parts)

    def find_cover(self, place: FloatArray) -> str:
        """Return what hides the target from ``place`` (2,) [m], as the beginning of a sentence."""
        geoms, elevations = self._look(place[None])
        others = geoms[(geoms >= 0) & ~np.isin(geoms, self._targets)]
        if (np.abs(elevations) > WINDOW / 2).all() or len(others) == 0:
            return (
                f"only what is within {np.degrees(WINDOW / 2):g} deg of the horizontal is modelled"
            )
        cover = _name(self._model, int(np.argmax(np.bincount(others))))
        return f"{cover} hides it from the lidar at a height of {LIDAR_HEIGHT:g} m"

    def _look(self, places: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return what rays from each of ``places`` (n, 2) to all aims meet first, and their angles.

        Geoms (n * n_aims,), and elevations above the horizontal (n * n_aims,) [rad].
        """
        origins = np.column_stack([places, np.full(len(places), LIDAR_HEIGHT)])
        origins = np.repeat(origins, len(self._aims), axis=0)
        rays = np.tile(self._aims, (len(places), 1)) - origins
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        hits = self._caster.cast(np.array(self._model.qpos0), origins, rays)
        return hits.geoms, np.arcsin(rays[:, 2])


def _aims(model: Any, geoms: list[int]) -> FloatArray:
    """Return about ``MAX_AIMS`` points (n, 3) [m] on the surface of ``geoms``, in ``map``."""
    # Choose the spacing
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    frames = [(data.geom_xmat[k].reshape(3, 3), data.geom_xpos[k]) for k in geoms]
    corners = [bounding_points(model, k) @ R.T + t for k, (R, t) in zip(geoms, frames, strict=True)]
    extent = float(np.linalg.norm(np.ptp(np.concatenate(corners), axis=0)))

    # Sample the surface
    points = np.concatenate(
        [
            sample_geom(model, k, extent / STEPS)[0] @ R.T + t
            for k, (R, t) in zip(geoms, frames, strict=True)
        ]
    )
    aims: FloatArray = points[:: max(1, len(points) // MAX_AIMS)]
    return aims


def _without_glass(model: Any, targets: list[int]) -> Any:
    """Return ``model`` without what is transparent and no target."""
    result = copy.copy(model)
    glass = find_transparency(model) > 0
    glass[targets] = False
    result.geom_rgba[glass] = 0.0
    return result


def _name(model: Any, geom: int) -> str:
    """Return the name of a geom, else that of the first named body above it."""
    body, found = int(model.geom_bodyid[geom]), str(model.geom(geom).name)
    while not found and body > 0:
        found, body = str(model.body(body).name), int(model.body_parentid[body])
    return found or "a thing without a name"
