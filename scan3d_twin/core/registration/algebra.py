"""Small algebra on normal equations: what they determine, and without what only gets in the way.

``native/algebra.h`` computes it.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import FloatArray, read_only

PLANAR_ENTRIES = read_only([0, 1, 5], np.int64)
"""Entries of x y z rx ry rz that are estimated on a floor: x, y and rz."""
ALL_ENTRIES = read_only(range(6), np.int64)
UNKNOWN = 1e-9
"""Share of the largest information below which a direction is taken as unknown."""


def invert_information(information: FloatArray, least: float = UNKNOWN) -> FloatArray:
    """Return the inverse of an information (k, k); 0 on the directions that nothing determines.

    Args:
        information: Symmetric (k, k), k at most 8.
        least: Share of the largest eigenvalue that a direction needs to be determined.
    """
    inverse = np.empty(information.shape)
    engine.inverse(np.ascontiguousarray(information), len(information), least, inverse)
    return inverse


def marginalise(information: FloatArray, known: float) -> FloatArray:
    """Return the information (k, k) of the pose when the last entry is a free nuisance.

    Args:
        information: Of the pose and the nuisance (k + 1, k + 1).
        known: Information of the nuisance beforehand; infinite where it is exact.
    """
    k = len(information) - 1
    result = np.empty((k, k))
    engine.marginal(np.ascontiguousarray(information), k + 1, k, np.array([known]), result)
    return result


def find_determined(
    H: FloatArray, spurious: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return which directions the scans determine.

    With u the eigenvectors of H, turns scaled by ``reach``, those count whose information is at
    least twice what noise of the normals alone gives (Hatleskog and Alexis, arXiv 2410.10784).

    Args:
        H: Information of the scans (k, k), on x, y, theta or all six.
        spurious: What noise of the normals adds to it (k, k).
        reach: Length that makes turns comparable with shifts [m].

    Returns:
        The projector K (k, k) such that K H K^T and K g keep the determined directions, the same
        with each shortened by the root of the share that is real (k, k), and the others as unit
        rows (j, k).
    """
    k = len(H)
    entries = PLANAR_ENTRIES if k == 3 else ALL_ENTRIES
    kept, honest, dropped = (np.empty((k, k)) for _ in range(3))
    n = engine.determined(
        np.ascontiguousarray(H), np.ascontiguousarray(spurious), entries, k, reach,
        kept, honest, dropped,
    )  # fmt: skip
    return kept, honest, dropped[:n]
