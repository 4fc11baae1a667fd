"""Planes that scans show, for the calibration: found among surfels, and fitted with range errors.

The range error of a surface bends it: over r it is a curve of its own, as of its material and of
the angle at which it is seen. The fit of a plane may hold such a curve, piecewise linear between
``KNOTS``; what a reading beside the curve says then counts alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

PLANE_SEEDS, MAX_PLANES = 150, 12
"""Surfels tried as the start of a plane, and largest number of planes per place."""
MAX_COUNTED = 20_000
"""Readings from which on only a share of them is counted to choose a start."""
FIRST_PLANE_DISTANCE, MIN_NORMAL_COSINE = 0.04, math.cos(math.radians(10.0))
"""Largest distance of a reading from its plane in the first fit [m], and smallest cosine of the
angle between their normals."""
FINAL_PLANE_DISTANCE = 0.02
"""Largest distance of a reading from its plane in later fits [m]."""
MIN_PLANE_READINGS, MIN_PLANE_EXTENT = 60, 0.4
"""Smallest number of readings of a plane, and its smallest extent [m]."""
KERNEL_WIDTH = 2.0
"""Width of the Geman-McClure kernel [sigma]."""
KNOTS = np.arange(0.25, 4.6, 0.25)
"""Ranges between which a range error is linear [m], as far apart as those of the registration."""
CURVE_SIGMA = 0.010
"""Range error at a knot, standard deviation [m]; data sheet of the URG-04LX: +-10 mm."""
STEEP = math.cos(math.radians(15.0))
"""Cosine of the angle to the vertical within which the normal of a floor lies."""


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """A plane fitted to readings.

    Attributes:
        normal: Its unit normal (3,), either way.
        axes: Two unit vectors in it (3, 2).
        residuals: Distances of the readings from it (m,) [m].
        weights: Their weights, by the kernel (m,) [1/m2].
        own: Change of the distances by the unknowns of the plane (m, k): its distance, its slopes
            along ``axes``, then the range error at each knot.
        inverse: Inverse of the normal equations of these unknowns (k, k).
    """

    normal: FloatArray
    axes: FloatArray
    residuals: FloatArray
    weights: FloatArray
    own: FloatArray
    inverse: FloatArray

    def solve(self, columns: FloatArray) -> FloatArray:
        """Return the unknowns (k, ...) that explain ``columns`` (m, ...) best."""
        weighted = self.own * self.weights[:, None]
        return np.asarray(self.inverse @ (weighted.T @ columns))

    def eliminate(self, columns: FloatArray) -> FloatArray:
        """Return ``columns`` (m, ...) less what the plane's own unknowns explain of them."""
        return np.asarray(columns - self.own @ self.solve(columns))

    @property
    def best_normal(self) -> FloatArray:
        """The unit normal (3,) with the range error taken off."""
        slopes = self.solve(self.residuals)[1:3]
        normal = self.normal - self.axes @ slopes
        return np.asarray(normal / np.linalg.norm(normal))


def fit_plane(
    points: FloatArray, weights: FloatArray, rays: FloatArray | None, ranges: FloatArray
) -> PlaneFit:
    """Return the plane through ``points`` (m, 3).

    Args:
        points: The readings [m].
        weights: Their inverse variances (m,) [1/m2].
        rays: Change of the points by the range (m, 3), to fit a curve of range errors; None for
            none.
        ranges: Of the readings (m,) [m].
    """
    # Fit the plane alone
    centre = weights @ points / weights.sum()
    Q = points - centre
    _, axes = np.linalg.eigh((Q * weights[:, None]).T @ Q)
    normal, within = axes[:, 0], axes[:, 1:]
    e = Q @ normal
    own = np.column_stack([np.ones(len(points)), Q @ within])
    if rays is None:
        w = weights * _kernel(weights * e * e)
        inverse = np.asarray(np.linalg.inv(own.T @ (own * w[:, None])))
        return PlaneFit(normal, within, e, w, own, inverse)

    # Fit plane and curve, and once more without what is off
    own = np.column_stack([own, (rays @ normal)[:, None] * _find_shares(ranges)])
    prior = np.diag([0.0] * 3 + [CURVE_SIGMA**-2.0] * len(KNOTS))
    w = weights
    for _ in range(2):
        inverse = np.asarray(np.linalg.inv(own.T @ (own * w[:, None]) + prior))
        fit = PlaneFit(normal, within, e, w, own, inverse)
        left = fit.eliminate(e)
        w = weights * _kernel(weights * left * left)
    inverse = np.asarray(np.linalg.inv(own.T @ (own * w[:, None]) + prior))
    return PlaneFit(normal, within, e, w, own, inverse)


def _kernel(squares: FloatArray) -> FloatArray:
    """Return the weights of Geman and McClure for squared residuals [sigma2]."""
    return np.asarray((KERNEL_WIDTH**2 / (KERNEL_WIDTH**2 + squares)) ** 2)


def _find_shares(ranges: FloatArray) -> FloatArray:
    """Return the share (m, knots) that each knot has of the range error at ``ranges`` (m,) [m]."""
    step = KNOTS[1] - KNOTS[0]
    away = np.abs(np.clip(ranges, KNOTS[0], KNOTS[-1])[:, None] - KNOTS)
    return np.asarray(np.maximum(0.0, 1.0 - away / step))


def find_planes(points: FloatArray, normals: FloatArray, places: IntArray) -> list[IntArray]:
    """Return the indices of the readings on each plane, place by place, the largest plane first."""
    found = []
    for place in np.unique(places):
        free = np.flatnonzero(places == place)
        for _ in range(MAX_PLANES):
            plane = _find_largest_plane(points, normals, free)
            if plane is None:
                break
            found.append(plane)
            free = np.setdiff1d(free, plane, assume_unique=True)
    return found


def _find_largest_plane(points: FloatArray, normals: FloatArray, free: IntArray) -> IntArray | None:
    """Return the readings among ``free`` on the plane with the most of them; None if too few."""
    if len(free) < MIN_PLANE_READINGS:
        return None

    # Choose the seed with most readings
    P, n = points[free], normals[free]
    seeds = np.linspace(0, len(free) - 1, PLANE_SEEDS).astype(np.int64)
    some = np.s_[:: 1 + len(free) // MAX_COUNTED]
    on = _find_near(P[seeds], n[seeds], P[some], n[some])
    chosen = int(np.argmax(on.sum(axis=1)))
    best = on[chosen]
    if len(best) < len(free):
        best = _find_near(P[seeds[chosen]][None], n[seeds[chosen]][None], P, n)[0]

    # Fit a plane and gather again
    for gate in (FIRST_PLANE_DISTANCE, FINAL_PLANE_DISTANCE, FINAL_PLANE_DISTANCE):
        if np.count_nonzero(best) < MIN_PLANE_READINGS:
            return None
        centre = P[best].mean(axis=0)
        Q = P[best] - centre
        squares, axes = np.linalg.eigh(Q.T @ Q)
        normal = axes[:, 0] * np.sign(axes[:, 0] @ n[best].mean(axis=0))
        best = (np.abs((P - centre) @ normal) < gate) & (n @ normal > MIN_NORMAL_COSINE)

    # Require readings and extent
    extent = math.sqrt(12.0 * squares[1] / np.count_nonzero(best))
    return (
        free[best]
        if np.count_nonzero(best) >= MIN_PLANE_READINGS and extent > MIN_PLANE_EXTENT
        else None
    )


def _find_near(
    at: FloatArray, facing: FloatArray, points: FloatArray, normals: FloatArray
) -> BoolArray:
    """Return which of ``points`` (m, 3) are near the planes of k seeds, and face as they do (k, m).

    Args:
        at: The seeds (k, 3).
        facing: Their normals (k, 3).
        points: The readings (m, 3).
        normals: Their normals (m, 3).
    """
    offsets = np.sum(facing * at, axis=1)[:, None]
    near = np.abs(facing @ points.T - offsets) < FIRST_PLANE_DISTANCE
    return np.asarray(near & (facing @ normals.T > MIN_NORMAL_COSINE))
