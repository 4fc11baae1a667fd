"""Algebra of normal equations: inversion, marginalisation and the test for degeneracy."""

from __future__ import annotations

import math

import numpy as np

from reference.point_to_plane import Equations
from scan3d_twin.core.types import FloatArray

SIGNAL = 2.0
"""Least information of a determined direction, per spurious information."""
UNKNOWN = 1e-9
"""Share of the largest eigenvalue below which a direction counts as unknown."""


def picked(v: FloatArray, rows: tuple[int, ...]) -> FloatArray:
    """Return these entries of a vector (k,)."""
    result = np.empty(len(rows))
    for i in range(len(rows)):
        result[i] = v[rows[i]]
    return result


def block(M: FloatArray, rows: tuple[int, ...]) -> FloatArray:
    """Return these rows and columns of a matrix (k, k)."""
    result = np.empty((len(rows), len(rows)))
    for i in range(len(rows)):
        for j in range(len(rows)):
            result[i, j] = M[rows[i], rows[j]]
    return result


def projected(K: FloatArray, H: FloatArray) -> FloatArray:
    """Return K H K^T (k, k)."""
    return K @ H @ K.T


def inverse(information: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the inverse (k, k); without a prior, 0 on degenerate directions."""
    values, vectors = np.linalg.eigh(information)
    least = 0.0 if prior[0, 0] > 0.0 else UNKNOWN * values[-1]
    result = np.zeros(information.shape)
    for m in range(len(values)):
        if values[m] > least:
            for i in range(len(values)):
                for j in range(len(values)):
                    result[i, j] += vectors[i, m] * vectors[j, m] / values[m]
    return result


def without_scale(
    equations: Equations, prior: float, scale: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Eliminate the yaw scale by its Schur complement.

    Returns:
        Information (k, k) and gradient (k,) of the pose, and the scale's step as an affine function
        of the pose's (k + 1,), the constant last; 0 when the scale is taken as exact.
    """
    k = len(equations.gradient) - 1
    H, affine = equations.information - equations.lost, np.zeros(k + 1)
    own = H[k, k] + prior
    right = 0.0 if math.isinf(prior) else equations.gradient[k] + prior * scale
    for i in range(k):
        affine[i] = -H[i, k] / own
    affine[k] = -right / own
    reduced, g = np.empty((k, k)), np.empty(k)
    for i in range(k):
        for j in range(k):
            reduced[i, j] = H[i, j] + affine[i] * H[j, k]
        g[i] = equations.gradient[i] + affine[i] * right
    return reduced, g, affine


def determined(
    H: FloatArray, spurious: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the directions that the scans determine and those that are degenerate.

    Args:
        H: Information matrix of the scans (k, k), of x, y, theta or all six.
        spurious: Information that noise of the normals adds (k, k).
        reach: Length that makes rotations comparable with translations [m].

    Returns:
        The projector K (k, k) such that K H K^T and K g keep the determined directions, the same
        with each shortened by the root of the share that is not spurious (k, k), and the others as
        unit rows (j, k).
    """
    k = len(H)
    unit = np.ones(k)
    unit[2 if k == 3 else 3 :] = 1.0 / reach
    scaled = np.empty((k, k))
    for i in range(k):
        scaled[i] = H[i] * unit[i] * unit
    values, vectors = np.linalg.eigh(scaled)
    kept, honest, dropped, n = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k)), 0
    for m in range(k):
        direction = vectors[:, m] * unit
        noise = quadratic(spurious, direction)
        if values[m] > 0 and values[m] >= SIGNAL * max(noise, 1e-12 * values[-1]):
            share = math.sqrt(1.0 - noise / values[m])
            for i in range(k):
                onto = vectors[i, m] / unit[i] * direction
                kept[i] += onto
                honest[i] += share * onto
        else:
            dropped[n] = direction / math.sqrt(np.sum(direction * direction))
            n += 1
    return kept, honest, dropped[:n].copy()


def quadratic(M: FloatArray, v: FloatArray) -> float:
    """Return v . M v."""
    result = 0.0
    for i in range(len(v)):
        for j in range(len(v)):
            result += v[i] * M[i, j] * v[j]
    return result
