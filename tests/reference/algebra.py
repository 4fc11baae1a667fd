"""Algebra of normal equations: inversion, marginalisation and the test for degeneracy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

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


class State(NamedTuple):
    """Normal equations of the pose, nuisances, and errors that readings share: H (n, n), g (n,)."""

    H: FloatArray
    g: FloatArray


def with_prior(state: State, entry: int, known: float, value: float) -> State:
    """Return the equations with prior information on an entry that is now ``value``.

    Infinite: the entry stays as it is.
    """
    H, g = state.H.copy(), state.g.copy()
    if math.isinf(known):
        H[entry], H[:, entry], g[entry] = 0.0, 0.0, 0.0
        H[entry, entry] = 1.0
    else:
        H[entry, entry] += known
        g[entry] += known * value
    return State(H, g)


def without_directions(state: State, dropped: FloatArray) -> State:
    """Return the equations as if the data could shift freely along ``dropped`` (j, k).

    That is a free unknown for each direction, of which the data see what they see of the pose, and
    which is marginalised.
    """
    V = np.zeros((len(state.g), len(dropped)))
    V[: dropped.shape[1]] = dropped.T
    seen, inside = state.H @ V, np.linalg.pinv(V.T @ state.H @ V, rcond=1e-12, hermitian=True)
    return State(state.H - seen @ inside @ seen.T, state.g - seen @ inside @ (V.T @ state.g))


def eliminated(state: State, k: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Eliminate the entries after the first k.

    Returns:
        Information (k, k) and gradient (k,) of the first, and the others' step as an affine
        function of theirs: matrix (n - k, k) and constant (n - k,).
    """
    H, g = state
    by = -np.linalg.solve(H[k:, k:], H[k:, :k])
    constant = -np.linalg.solve(H[k:, k:], g[k:])
    return H[:k, :k] + H[:k, k:] @ by, g[:k] + H[:k, k:] @ constant, by, constant


def determined(
    H: FloatArray, spurious: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return the directions that the scans determine and those that are degenerate.

    Args:
        H: Information matrix of the scans (k, k), of x, y, theta or all six.
        spurious: Information that noise of the normals adds (k, k).
        reach: Length that makes rotations comparable with translations [m].

    Returns:
        The projector K (k, k) such that K H K^T and K g keep the determined directions, the same
        with each shortened by the root of the share that is not spurious (k, k), the others as unit
        rows (j, k), and the least information of a direction per spurious information.
    """
    k = len(H)
    unit = np.ones(k)
    unit[2 if k == 3 else 3 :] = 1.0 / reach
    scaled = np.empty((k, k))
    for i in range(k):
        scaled[i] = H[i] * unit[i] * unit
    values, vectors = np.linalg.eigh(scaled)
    kept, honest, dropped, n = np.zeros((k, k)), np.zeros((k, k)), np.zeros((k, k)), 0
    least = math.inf
    for m in range(k):
        direction = vectors[:, m] * unit
        noise = quadratic(spurious, direction)
        floor = max(noise, 1e-12 * values[-1])
        least = min(least, values[m] / floor if values[m] > 0 else 0.0)
        if values[m] > 0 and values[m] >= SIGNAL * floor:
            share = math.sqrt(1.0 - noise / values[m])
            for i in range(k):
                onto = vectors[i, m] / unit[i] * direction
                kept[i] += onto
                honest[i] += share * onto
        else:
            dropped[n] = direction / math.sqrt(np.sum(direction * direction))
            n += 1
    return kept, honest, dropped[:n].copy(), least


def quadratic(M: FloatArray, v: FloatArray) -> float:
    """Return v . M v."""
    result = 0.0
    for i in range(len(v)):
        for j in range(len(v)):
            result += v[i] * M[i, j] * v[j]
    return result
