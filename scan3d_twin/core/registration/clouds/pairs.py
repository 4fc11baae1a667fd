"""Pairs of surface patches of two clouds, and their robust weights.

A source patch is paired with the nearest target patch of the same size whose normal is alike. With
a = R p, its place p' = a + t, the target's place q, n the mean of both normals and n_s, n_t either

    e = n . (p' - q),   J = (n, a x n),   D = (n_s - n_t, a x (n_s - n_t)) / 2

(symmetric point to plane: Rusinkiewicz, SIGGRAPH 2019). e varies by l1 / N (1 + d^2 / (4 l2)) for
either window of N points: by its mean, and by half its normal over the distance d = |p' - q|.
``native/cells.h`` finds the pairs.
"""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.registration.clouds.patches import Level
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.point_to_plane import MIN_NORMAL_COSINE
from scan3d_twin.core.types import FloatArray, SmallIntArray

JACOBIAN, DIFFERENCE = slice(0, 6), slice(6, 12)
RESIDUAL, SOURCE_VARIANCE, TARGET_VARIANCE, PAIR = 12, 13, 14, 15
"""Columns of a pair: J, D, e [m] and the variances of e by source and target [m2], in the order of
``native/cells.h``."""
ROBUST_SCALE = 3.0
"""Scale c of the robust kernel, in spreads of the residuals."""
MIN_SPREAD = 1e-6
"""Least spread of the residuals [m], so that noise-free clouds keep finite weights."""


def pair_patches(
    target: Level, patches: FloatArray, T: FloatArray, gate: float
) -> tuple[FloatArray, SmallIntArray]:
    """Return pairs (k, PAIR) of source patches with patches of a level of the target.

    The second value holds the indices (k, 2) of the source's patch and of the target's flat patch.
    """
    pairs, indices = np.empty((len(patches), PAIR)), np.empty((len(patches), 2), np.int32)
    tree = target.tree
    k = engine.pair_patches(
        tree.points, tree.order, tree.axes, len(tree.points), target.flat_patches, patches,
        len(patches), np.ascontiguousarray(T), gate, MIN_NORMAL_COSINE, pairs, indices,
    )  # fmt: skip
    return pairs[:k], indices[:k]


def standardise(pairs: FloatArray) -> FloatArray:
    """Return the residuals of pairs (n, PAIR) in the standard deviations expected of them (n,)."""
    variance = pairs[:, SOURCE_VARIANCE] + pairs[:, TARGET_VARIANCE]
    return np.asarray(pairs[:, RESIDUAL] / np.sqrt(np.maximum(variance, MIN_SPREAD**2)))


def robust_spread(values: FloatArray) -> float:
    """Return the robust standard deviation: 1.4826 median absolute deviations."""
    off = np.array(values)
    off -= engine.find_median(off, len(off))  # which reorders them, in a tenth of NumPy's time
    return 1.4826 * float(engine.find_median(np.abs(off, out=off), len(off)))


def weigh(z: FloatArray) -> FloatArray:
    """Return the weights of Geman and McClure's kernel for residuals in spreads."""
    return np.asarray((ROBUST_SCALE**2 / (ROBUST_SCALE**2 + z * z)) ** 2)
