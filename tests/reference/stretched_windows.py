"""Noise of normals over windows that a slanting ray stretches, in NumPy.

``point_to_plane.faked`` takes the variance nu of a normal as the same about both tangents, of which
it is the mean. A window met at an incidence of cosine b is 1 / b times as long along the ray's
trace as across it, so that the normal varies by 2 nu / (1 + b^2) across and b^2 as much along. The
sum over both normals of a pair, of which each is half of the mean, changes by

    w nu / (4 (1 + b^2)) (J_v J_v^T - J_u J_u^T),   u = d - (n . d) n,   v = n x d,

with d the ray and J_x = (x, a x x).
"""

from __future__ import annotations

import numpy as np

from reference.point_to_plane import Gate, PairNoise, linearised
from reference.scan_arrays import Sample, Target
from reference.shared_errors import rays
from scan3d_twin.core.types import FloatArray

MOST_STRETCH = 2.0
"""Largest variance of a normal about one tangent, per mean over both."""


def stretched(
    target: Target,
    sample: Sample,
    T: FloatArray,
    scale: float,
    gate: Gate,
    both: PairNoise,
    entries: tuple[int, ...],
) -> FloatArray:
    """Return the change (k, k); arguments as of ``point_to_plane.normal_equations``."""
    pairs = linearised(target, sample, T, scale, gate, both)
    mount = target.projection.mount
    own = rays(pairs.p, both.ahead, both.up)[1] @ T[:3, :3].T
    other = rays(pairs.q, mount[5], mount[7])[1]
    n, change = pairs.J[:, :3], np.zeros((6, 6))
    for d, nu in ((own, pairs.nu_s), (other, pairs.nu_t)):
        b = np.sum(n * d, axis=1)
        weight = pairs.w * nu / (4.0 * (1.0 + b * b))
        for tangent, sign in ((np.cross(n, d), 1.0), (d - b[:, None] * n, -1.0)):
            J = np.concatenate([tangent, np.cross(pairs.a, tangent)], axis=1)
            change += sign * (J * weight[:, None]).T @ J
    return change[np.ix_(entries, entries)]
