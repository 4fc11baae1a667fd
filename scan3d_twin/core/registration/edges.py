"""Vertical edges where a surface ends in view: what fixes a slide along a flat face.

Where a line sees a surface and the next one something farther, or several nothing, the surface
ends between the two. A run of beams that all jump there is one vertical edge, measured once: its
yaw is known to a line spacing, so across the ray its variance is (r dyaw)^2 / 12 + (r sigma_yaw)^2.
The surface must be seen steeply enough: a curved body's outline has no place of its own and wanders
with the viewpoint. ``native/edges.h`` finds them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels import sweep_of
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Pose2,
    RangeImage,
    SmallIntArray,
)

JUMP = 0.10
"""Least step in range at an edge [m]; several sigma, and more than a steep face within a line."""
MIN_BEAMS = 8
"""Beams in a run."""
MIN_COSINE = 0.35
"""A surface seen flatter at its edge (70 deg from the normal) may be turning away."""
INWARDS = 2
"""Lines from the edge to the surfel that carries it: nearer windows would cross the edge."""
FIRST_ROOM = 512
"""Edges for which there is room at first."""


@dataclass(frozen=True)
class Edges:
    """Vertical edges in frame ``scan``.

    Attributes:
        places: Top view (n, 2) [m].
        across: Unit vectors across the ray (n, 2).
        variances: Of the place along ``across`` (n,) [m2].
        sides: 1 where the surface ends to the right, -1 to the left (n,).
        heights: Lowest and highest point (n, 2) [m].
    """

    places: FloatArray
    across: FloatArray
    variances: FloatArray
    sides: IntArray
    heights: FloatArray

    def __len__(self) -> int:
        return len(self.places)

    @staticmethod
    def of(rows: FloatArray) -> Edges:
        """Return the edges of ``edge_rows`` (n, 8)."""
        sides = rows[:, 5].astype(np.int64)
        return Edges(rows[:, :2], rows[:, 2:4], rows[:, 4], sides, rows[:, 6:])

    @cached_property
    def rows(self) -> FloatArray:
        """The edges as place, across, variance, side and heights (n, 8)."""
        parts = [self.places, self.across, self.variances[:, None], self.sides[:, None]]
        return np.concatenate([*parts, self.heights], axis=1)

    def select(self, mask: BoolArray) -> Edges:
        """Return the edges where ``mask`` (n,) is True."""
        return Edges(
            self.places[mask],
            self.across[mask],
            self.variances[mask],
            self.sides[mask],
            self.heights[mask],
        )

    def seen_from(self, T: Pose2) -> Edges:
        """Return the edges in another frame, ``T`` maps into it, as well known as they are here."""
        return replace(self, places=T.apply(self.places), across=T.rotate(self.across))


def find_edges(
    image: RangeImage, rows: FloatArray, index: SmallIntArray, valid: BoolArray, yaw_sigma: float
) -> FloatArray:
    """Return the vertical edges of a sweep as place, across, variance, side and heights (n, 8).

    Args:
        image: The sweep.
        rows: Its surfels (m, 8).
        index: Row of each reading (n_lines, n_beams), or -1.
        valid: Readings that are distances (n_lines, n_beams).
        yaw_sigma: Of a line [rad].
    """
    sweep, room = sweep_of(image), FIRST_ROOM
    while True:
        edges = np.empty((room, 8))
        n = engine.edges(sweep, rows, index, valid, yaw_sigma, edges, room)
        if n < 0:
            raise MemoryError
        if n < room:
            return edges[:n].copy()
        room *= 4


def edge_equations(
    target: Edges, source: Edges, T: FloatArray, distance: float, robust: float
) -> tuple[FloatArray, FloatArray]:
    """Return information (6, 6) and gradient (6,) of the edges at ``T`` (4, 4).

    Each source edge is paired with the nearest target edge of its side at its height; the residual
    is their distance across the target's ray.

    Args:
        target: What the source is laid on.
        source: Its edges.
        T: ``T_target_source``.
        distance: Farther edges are not paired [m].
        robust: c of the weights, in standard deviations.
    """
    H, g = np.zeros((6, 6)), np.zeros(6)
    T = np.ascontiguousarray(T)
    engine.edge_equations(
        target.rows, len(target), source.rows, len(source), T, distance, robust, H, g
    )
    return H, g
