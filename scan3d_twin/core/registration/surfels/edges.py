"""Vertical edges where a surface ends: features that constrain a slide along a flat face.

If a line sees a surface and the next one something farther, or several lines in a row nothing, the
surface ends between the two. A run of adjacent beams with such a range step is one vertical edge,
measured once: its yaw is known to a line spacing, so its variance across the ray is
(r dyaw)^2 / 12 + (r sigma_yaw)^2. The surface must not be seen at grazing incidence: the silhouette
of a curved body moves with the viewpoint. ``native/edges.h`` finds the edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.extraction import make_native_sweep
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    Pose2,
    RangeImage,
    SmallIntArray,
)

MIN_RANGE_STEP = 0.10
"""Least range step at an edge [m]: several sigma, and more than a steep face gives per line."""
MIN_BEAMS = 8
"""Least number of adjacent beams in an edge."""
MIN_EDGE_COSINE = 0.35
"""Least cosine of incidence at an edge (70 deg): a surface seen flatter may be a silhouette."""
SURFEL_OFFSET = 2
"""Lines from an edge to the surfel of its face: windows nearer by would cross the edge."""
INITIAL_ROOM = 512
"""Number of edges that the first buffer holds."""


@dataclass(frozen=True)
class Edges:
    """Vertical edges in frame ``scan``.

    Attributes:
        places: Positions in the top view (n, 2) [m].
        across: Unit vectors across the rays (n, 2).
        variances: Variances of the positions along ``across`` (n,) [m2].
        sides: 1 where the surface ends to the right, -1 to the left (n,).
        heights: z of the lowest and the highest point (n, 2) [m].
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
        """The edges as rows of place, across, variance, side and heights (n, 8)."""
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
        """Return the edges in the frame that ``T`` maps into, with the same variances."""
        return replace(self, places=T.apply(self.places), across=T.rotate(self.across))


def find_edges(
    image: RangeImage, rows: FloatArray, index: SmallIntArray, valid: BoolArray, yaw_sigma: float
) -> FloatArray:
    """Return the vertical edges of a sweep as rows of ``Edges`` (n, 8).

    Args:
        image: The sweep.
        rows: Its surfels (m, 8).
        index: Row of each reading's surfel (n_lines, n_beams), or -1.
        valid: Whether a reading is a distance (n_lines, n_beams).
        yaw_sigma: Yaw jitter of a line [rad].
    """
    sweep, room = make_native_sweep(image), INITIAL_ROOM
    while True:
        edges = np.empty((room, 8))
        n = engine.find_edges(sweep, rows, index, valid, yaw_sigma, edges, room)
        if n < 0:
            raise MemoryError
        if n < room:
            return edges[:n].copy()
        room *= 4


def linearise_edges(
    target: Edges, source: Edges, T: FloatArray, distance: float, robust: float
) -> tuple[FloatArray, FloatArray]:
    """Return information matrix (6, 6) and gradient (6,) of the edges at ``T`` (4, 4).

    Each source edge is paired with the nearest target edge of its side at its height; the residual
    is their distance across the target's ray.

    Args:
        target: Edges of the target.
        source: Edges of the source.
        T: ``T_target_source``.
        distance: Gate: edges farther apart are not paired [m].
        robust: Scale c of the robust kernel, in standard deviations.
    """
    H, g = np.zeros((6, 6)), np.zeros(6)
    T = np.ascontiguousarray(T)
    engine.linearise_edges(
        target.rows, len(target), source.rows, len(source), T, distance, robust, H, g
    )
    return H, g
