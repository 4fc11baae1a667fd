"""Transparent things: how much light they let through, and what comes back from behind them.

A geom that is drawn with 0 < alpha < 1 is a pane of glass. On its way in and back the light passes
it, unpolarised, with the share

    T = (1 - alpha) / 2 * sum over s, p of (1 - R) / (1 + R),

R_s and R_p of Fresnel's equations, all reflections inside the pane included (E. Hecht, Optics, 5th
ed., sec. 4.6.3 and 9.6). T falls towards grazing incidence, where nothing from behind returns. The
pane itself returns what its smooth surface mirrors back near the normal, and what its opaque share
scatters (``optics``). The pane does not shift the ray: 2 mm for 6 mm of glass at 45 deg. What
mirrored light meets is not modelled.

A sensor that measures phases adds the returns of all surfaces (``footprint.mix``): of the pane,
of what is behind, between both, or an error code where its modulations disagree. Others report the
strongest return.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray
from scan3d_twin.devices.device import LidarSensor
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.footprint import Mixed, mix
from scan3d_twin.sim.lidar.optics import Materials
from scan3d_twin.sim.ray_casting import Hits, RayCaster
from scan3d_twin.sim.scenes.orientation import is_closed
from scan3d_twin.sim.scenes.tessellation import mesh_triangles
from scan3d_twin.sim.scenes.visibility import find_transparency

REFRACTIVE_INDEX = 1.51
"""Of soda-lime float glass at 785 and 905 nm (M. Rubin, Solar Energy Materials 12, 1985)."""
MAX_SURFACES = 8
"""Most surfaces that a ray is followed through, two for each solid pane; what lies behind more of
them returns nothing (assumption)."""
STEP = 1e-4
"""Distance beyond a surface from which a ray goes on [m]: above the rounding of single precision,
less than a pane is thick."""


@dataclass(frozen=True)
class Returns:
    """What rays meet, surface by surface (n_surfaces, n).

    Attributes:
        distances: [m]; inf where there is nothing.
        power: Of what comes back through all before it; 0 where there is nothing.
        cosines: Of the incidence.
        normals: Unit normals (n_surfaces, n, 3).
        geoms: Geom ids; -1 where there is nothing.
    """

    distances: FloatArray
    power: FloatArray
    cosines: FloatArray
    normals: FloatArray
    geoms: IntArray


def transmittance(cosines: FloatArray) -> FloatArray:
    """Return the share (n,) of unpolarised light that passes a clear pane at ``cosines`` (n,)."""
    n = REFRACTIVE_INDEX
    inside = np.sqrt(1 - (1 - cosines**2) / n**2)
    s = ((cosines - n * inside) / (cosines + n * inside)) ** 2
    p = ((n * cosines - inside) / (n * cosines + inside)) ** 2
    result: FloatArray = ((1 - s) / (1 + s) + (1 - p) / (1 + p)) / 2
    return result


class Panes:
    """The transparent geoms of a scene."""

    def __init__(self, model: Any, transparency: FloatArray, caster: RayCaster) -> None:
        self._caster = caster
        self._passing = np.append(transparency, 0.0)  # the last is for a miss
        self._kinds = np.append(model.geom_type, -1)
        meshes = self._kinds == mujoco.mjtGeom.mjGEOM_MESH
        self._closed_meshes = np.zeros(len(self._kinds), bool)
        for geom in np.flatnonzero(meshes & (self._passing > 0)).tolist():
            self._closed_meshes[geom] = is_closed(mesh_triangles(model, geom))

    @staticmethod
    def of(model: Any, caster: RayCaster) -> Panes | None:
        """Return the panes of ``model``; None without any: rays end at the first hit."""
        transparency = find_transparency(model)
        return Panes(model, transparency, caster) if transparency.any() else None

    def first_opaque_hits(
        self, qpos: FloatArray, origins: FloatArray, directions: FloatArray
    ) -> FloatArray:
        """Return the distances (n,) [m] at which rays end, see ``RayCaster.cast``."""
        first = self._caster.cast(qpos, origins, directions)
        distances = first.distances.copy()
        rays = np.flatnonzero(self._passing.take(first.geoms) > 0)
        for hits, there, _ in self._follow(
            qpos, origins[rays], directions[rays], _pick(first, rays)
        ):
            distances[rays[there]] = hits.distances
        return distances

    def look_through(
        self,
        qpos: FloatArray,
        rays: tuple[FloatArray, FloatArray],
        hits: Hits,
        cosines: FloatArray,
        materials: Materials,
        beams: int,
        optics: tuple[LidarModelConfig, LidarSensor],
        mixed: Mixed,
    ) -> tuple[Hits, FloatArray, Mixed]:
        """Return hits, cosines and light of beams with what is behind transparent things.

        Args:
            qpos: Positions of the scene's moving objects.
            rays: Origins and directions (K * beams, 3) of the sub-rays.
            hits: What they hit first.
            cosines: Of the incidence there (K * beams,).
            materials: Of the scene's geoms.
            beams: Number of beams.
            optics: Configuration and sensor.
            mixed: What the receiver would get of the first hits.

        Returns:
            The strongest hit of each sub-ray, its cosine, and the received light of each beam.
        """
        # Follow the rays of all beams that meet a pane
        met = (self._passing.take(hits.geoms) > 0).reshape(-1, beams).any(axis=0)
        columns = np.flatnonzero(met)
        if len(columns) == 0:
            return hits, cosines, mixed
        n_sub = len(hits.distances) // beams
        chosen = (np.arange(n_sub)[:, None] * beams + columns).ravel()
        returns = self._find_returns(
            qpos, rays[0][chosen], rays[1][chosen], _pick(hits, chosen), materials
        )

        # Take the strongest return of each ray
        strongest = returns.power.argmax(axis=0)
        if optics[1].modulations is None:
            strongest = _agree(returns, strongest, n_sub)
        at = strongest, np.arange(len(chosen))
        result = Hits(hits.distances.copy(), hits.normals.copy(), hits.geoms.copy())
        cosines = cosines.copy()
        result.distances[chosen], result.geoms[chosen] = returns.distances[at], returns.geoms[at]
        result.normals[chosen], cosines[chosen] = returns.normals[at], returns.cosines[at]

        # Mix what comes back
        distances, power = returns.distances, returns.power
        if optics[1].modulations is None:
            distances, power = distances[at][None], power[at][None]
        rows = len(distances) * n_sub
        light = mix(distances.reshape(rows, -1), power.reshape(rows, -1) * (rows / n_sub), *optics)
        return result, cosines, _replace(mixed, columns, light)

    def _find_returns(
        self,
        qpos: FloatArray,
        origins: FloatArray,
        directions: FloatArray,
        first: Hits,
        materials: Materials,
    ) -> Returns:
        """Return what rays meet, up to the first opaque surface."""
        n = len(origins)
        layers = []
        passed = np.ones(n)
        for hits, there, leaving in self._follow(qpos, origins, directions, first):
            # A pane counts where it is entered
            hits, there = _pick(hits, np.flatnonzero(~leaving)), there[~leaving]
            if len(there) == 0:
                continue
            row = Returns(
                np.full(n, np.inf),
                np.zeros(n),
                np.zeros(n),
                np.zeros((n, 3)),
                np.full(n, -1, np.int64),
            )
            cosines = np.abs(np.einsum("ni,ni->n", hits.normals, directions[there]))
            power = materials.power(hits.geoms, cosines, hits.distances) * passed[there] ** 2
            row.distances[there], row.power[there], row.cosines[there] = (
                hits.distances,
                power,
                cosines,
            )
            row.normals[there], row.geoms[there] = hits.normals, hits.geoms
            passed[there] *= self._passing.take(hits.geoms) * transmittance(cosines)
            layers.append(row)
        return Returns(
            *(
                np.stack([getattr(row, name) for row in layers])
                for name in ("distances", "power", "cosines", "normals", "geoms")
            )
        )

    def _follow(
        self,
        qpos: FloatArray,
        origins: FloatArray,
        directions: FloatArray,
        first: Hits,
    ) -> Iterator[tuple[Hits, IntArray, BoolArray]]:
        """Yield what rays hit one surface after the other, which rays (m,), and if they leave it.

        The first are all rays; those that ended are left out. Distances are from ``origins``.
        """
        going, hits = np.arange(len(origins)), first
        inside = np.full(len(origins), -1)
        for _ in range(MAX_SURFACES):
            leaving = self._do_leave(hits, directions[going], inside[going])
            yield hits, going, leaving
            inside[going] = np.where(leaving, -1, hits.geoms)
            on = np.flatnonzero(self._passing.take(hits.geoms) > 0)
            if len(on) == 0:
                return
            going, travelled = going[on], hits.distances[on] + STEP
            starts = origins[going] + travelled[:, None] * directions[going]
            hits = self._caster.cast(qpos, starts, np.ascontiguousarray(directions[going]))
            hits = Hits(hits.distances + travelled, hits.normals, hits.geoms)

    def _do_leave(self, hits: Hits, directions: FloatArray, inside: IntArray) -> BoolArray:
        """Return which rays (n,) leave the pane that they hit, rather than enter it.

        Primitives by their normals; closed meshes at every other hit, as their winding says
        nothing. Planes and open meshes are sheets: each hit is a whole pane.
        """
        kinds = self._kinds.take(hits.geoms)
        solid = (kinds != mujoco.mjtGeom.mjGEOM_MESH) & (kinds != mujoco.mjtGeom.mjGEOM_PLANE)
        outwards = np.einsum("ni,ni->n", hits.normals, directions) > 0
        again = self._closed_meshes.take(hits.geoms) & (hits.geoms == inside)
        pane = self._passing.take(hits.geoms) > 0
        return np.asarray(pane & ((solid & outwards) | again))


def _pick(hits: Hits, rays: IntArray) -> Hits:
    """Return the ``hits`` of some ``rays`` (m,)."""
    return Hits(hits.distances[rays], hits.normals[rays], hits.geoms[rays])


def _agree(returns: Returns, strongest: IntArray, n_sub: int) -> IntArray:
    """Return which return of each ray (n,) is nearest to the strongest of its beam.

    A receiver of pulses resolves the returns of a pane and of what is behind.
    """
    rays = np.arange(len(strongest))
    distances = returns.distances[strongest, rays].reshape(n_sub, -1)
    power = returns.power[strongest, rays].reshape(n_sub, -1)
    beams = np.arange(distances.shape[1])
    wanted = np.tile(distances[power.argmax(axis=0), beams], n_sub)
    finite = np.where(np.isfinite(returns.distances), returns.distances, 1e9)
    aim = np.where(np.isfinite(wanted), wanted, 1e9)
    return np.asarray(np.abs(finite - aim).argmin(axis=0))


def _replace(mixed: Mixed, columns: IntArray, light: Mixed) -> Mixed:
    """Return ``mixed`` with the ``light`` of the beams ``columns`` (m,)."""
    distances, power = mixed.distances.copy(), mixed.power.copy()
    distances[columns], power[columns] = light.distances, light.power
    kept = ~np.isin(mixed.broken, columns)
    broken = np.concatenate([mixed.broken[kept], columns[light.broken]])
    return Mixed(distances, power, broken, np.concatenate([mixed.codes[kept], light.codes]))
