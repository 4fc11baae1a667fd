"""Algebra of normal equations: inversion, marginalisation and the test for degeneracy.

``native/algebra.h`` computes it.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import FloatArray, read_only

PLANAR_ENTRIES = read_only([0, 1, 5], np.int64)
"""Entries of x y z rx ry rz that a robot on a floor estimates: x, y and rz."""
ALL_ENTRIES = read_only(range(6), np.int64)
MIN_INFORMATION_SHARE = 1e-9
"""Share of the largest eigenvalue below which a direction counts as unknown."""


def invert_information(information: FloatArray, least: float = MIN_INFORMATION_SHARE) -> FloatArray:
    """Return the inverse of an information matrix (k, k); 0 on directions it does not determine.

    Args:
        information: Symmetric matrix (k, k), k at most 8.
        least: Share of the largest eigenvalue above which a direction is determined.
    """
    inverse = np.empty(information.shape)
    engine.invert_information(np.ascontiguousarray(information), len(information), least, inverse)
    return inverse


def marginalise(information: FloatArray, known: float) -> FloatArray:
    """Return the information matrix (k, k) of the pose with the nuisance parameter marginalised.

    Args:
        information: Information of the pose and, last, the nuisance (k + 1, k + 1).
        known: Prior information of the nuisance; infinite if it is known exactly.
    """
    k = len(information) - 1
    result = np.empty((k, k))
    engine.marginalise(np.ascontiguousarray(information), k + 1, k, np.array([known]), result)
    return result


def find_determined(
    H: FloatArray, spurious: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the directions that the scans determine and those that are degenerate.

    An eigenvector of H, with rotations scaled by ``reach``, is determined if its information is at
    least twice what noise of the normals alone gives (Hatleskog and Alexis, arXiv 2410.10784).

    Args:
        H: Information matrix of the scans (k, k), of x, y, theta or all six.
        spurious: Information that noise of the normals adds (k, k).
        reach: Length that makes rotations comparable with translations [m].

    Returns:
        The projector K (k, k) such that K H K^T and K g keep the determined directions; K with each
        direction times the root of its share that is not spurious (k, k); and the degenerate
        directions as unit rows (j, k).
    """
    k = len(H)
    entries = PLANAR_ENTRIES if k == 3 else ALL_ENTRIES
    kept, honest, dropped = (np.empty((k, k)) for _ in range(3))
    n = engine.find_determined(
        np.ascontiguousarray(H), np.ascontiguousarray(spurious), entries, k, reach,
        kept, honest, dropped,
    )  # fmt: skip
    return kept, honest, dropped[:n]
