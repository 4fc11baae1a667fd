"""The last step's equations with every error that readings share as an unknown, in NumPy.

To each pair's residual e belongs the linear model

    e + J x + b_s (patch + curve(r_s)) - b_t curve(r_t) + c (yaw of the line) = noise,

with b the cosine between the normal and a ray, r its length. All derivatives are those at the point
on the source's ray on which both readings agree best: there the share v_s / (v_s + v_t) of e has
been taken from the source's reading, so that its noise is independent of that of e. Each of these
unknowns is a column of the Jacobian, the normal equations follow, and the priors are added: 1 for a
patch's errors in units of the assumed one, the stride for a line's, the inverse of the curve's
covariance, and the floor's unevenness for the entries of the pose that are not estimated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import sparse

from reference.point_to_plane import Gate, PairNoise, Pairs, faked, linearised
from reference.scan_arrays import Sample, Target
from reference.surfels import MIN_COSINE, X
from scan3d_twin.core.types import FloatArray, IntArray

COLUMNS, BANDS = 24, 12
"""Patches in azimuth, and in height over the sphere of directions."""
KNOTS, SPACING, LENGTH = 24, 0.25, 0.25
"""Of the range error's curve over the range, and the range over which it changes [m]."""
LEAST_CURVE_SIGMA = 1e-4
"""[m]."""
ASSUMED = 4
"""What the assumption counts like, in errors, in the estimate of their spread."""


class SharedErrors(NamedTuple):
    """Normal equations of all unknowns: patches (3 m), lines (l), then the state (31).

    The state is the estimated entries of the pose, the yaw scale, the other entries, the knots.

    Attributes:
        H: (3 m + l + 31, 3 m + l + 31).
        g: (3 m + l + 31,).
        patches: 3 m.
        spurious: Information that noise of the normals adds (k, k).
        pairs: Number of pairs.
        square: Sum of their squared residuals [m2].
    """

    H: FloatArray
    g: FloatArray
    patches: int
    spurious: FloatArray
    pairs: int
    square: float

    @property
    def state(self) -> int:
        """The first unknown of the state."""
        return len(self.g) - 7 - KNOTS

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """Return information (31, 31) and gradient (31,) of the state, all else marginalised."""
        return _schur(self.H, self.g, np.arange(self.state))

    def spread(self, step: FloatArray) -> float:
        """Return the patches' errors, in assumed ones, where the state takes ``step`` (31,)."""
        H, g = _schur(self.H, self.g, np.arange(self.patches, self.state))
        n = self.patches
        errors = -np.linalg.solve(H[:n, :n], g[:n] + H[:n, n:] @ step)
        pivots = np.diagonal(np.linalg.cholesky(H[:n, :n])) ** 2
        square = ASSUMED + np.sum(errors[::3] ** 2)
        return math.sqrt(square / (ASSUMED + np.sum(1.0 - 1.0 / pivots[::3])))


def state_spread(H: FloatArray, known: FloatArray, values: FloatArray) -> float:
    """Return the spread of the nuisances' ``values`` (m,), in units of what was ``known`` (m, m).

    ``H`` is their information (m, m) by the scans, too.
    """

    def pivots(M: FloatArray) -> FloatArray:
        return np.diagonal(np.linalg.cholesky(M[::-1, ::-1])) ** 2

    count = ASSUMED + np.sum(1.0 - pivots(known) / pivots(H))
    return math.sqrt((ASSUMED + values @ known @ values) / count)


def _schur(H: FloatArray, g: FloatArray, gone: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the equations without the unknowns ``gone``."""
    left = np.setdiff1d(np.arange(len(g)), gone)
    share = np.linalg.solve(H[np.ix_(gone, gone)], H[np.ix_(gone, left)]).T
    return H[np.ix_(left, left)] - share @ H[np.ix_(gone, left)], g[left] - share @ g[gone]


def shared_errors(
    target: Target,
    sample: Sample,
    T: FloatArray,
    scale: float,
    gate: Gate,
    both: PairNoise,
    entries: tuple[int, ...],
) -> SharedErrors:
    """Return the equations; arguments as of ``point_to_plane.normal_equations``."""
    single = both._replace(share=1.0 / both.correlation, tilt=0.0)
    pairs = linearised(target, sample, T, scale, gate, single)
    order = (*entries, 6, *(k for k in range(6) if k not in entries))

    # a column for each unknown
    patch = _patches(pairs, T, sample, both)
    lines = np.unique(pairs.lines, return_inverse=True)[1]
    of_line = sparse.csr_array((pairs.own, (np.arange(len(lines)), lines)))
    J, curve = _agreed(pairs, T, target.projection.mount, both)
    A = sparse.csr_array(sparse.hstack([patch, of_line, J[:, order], curve]))
    H, g = (A.T @ (A * pairs.w[:, None])).toarray(), A.T @ (pairs.w * pairs.e)

    # priors
    n_patch, n_line = patch.shape[1], of_line.shape[1]
    prior = np.concatenate([np.ones(n_patch), np.full(n_line, sample.stride), np.zeros(7 + KNOTS)])
    H += np.diag(prior)
    H[-7 - KNOTS :, -7 - KNOTS :] += state_prior(both, entries)
    square = float(pairs.e @ pairs.e)
    return SharedErrors(H, g, n_patch, faked(pairs, entries), len(pairs.e), square)


def state_prior(both: PairNoise, entries: tuple[int, ...]) -> FloatArray:
    """Return what is known of the state (31, 31) without the pose and the yaw scale."""
    order = (*entries, 6, *(k for k in range(6) if k not in entries))
    prior = np.zeros((7 + KNOTS, 7 + KNOTS))
    for k in range(len(entries) + 1, 7):
        prior[k, k] = 1.0 / (both.height if order[k] == 2 else both.lean) ** 2
    prior[-KNOTS:, -KNOTS:] = np.linalg.inv(curve_covariance(both.linearity, both.offset))
    return prior


def curve_covariance(linearity: float, offset: float) -> FloatArray:
    """Return the prior covariance of the knots (24, 24) [m2]."""
    d = SPACING * (np.arange(KNOTS)[:, None] - np.arange(KNOTS))
    smooth = linearity**2 / (1.0 + d**2 / (2 * LENGTH**2))
    return smooth + offset**2 + LEAST_CURVE_SIGMA**2 * np.eye(KNOTS)


def rays(points: FloatArray, ahead: float, up: float) -> tuple[FloatArray, FloatArray]:
    """Return lengths (n,) and directions (n, 3) of the rays to points (n, 3) in a scan's frame."""
    rho = np.hypot(points[:, 0], points[:, 1])
    ray = points - [0.0, 0.0, up]
    ray[:, :2] *= (1.0 - ahead / rho)[:, None]
    length = np.linalg.norm(ray, axis=1)
    return length, ray / length[:, None]


def places(directions: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return patches (n,) of directions (n, 3) and where in them they lie, -1 to 1 each way."""
    column = (np.arctan2(directions[:, 1], directions[:, 0]) / math.tau + 0.5) * COLUMNS
    band = (directions[:, 2] + 1.0) / 2.0 * BANDS
    i = np.clip(column.astype(int), 0, COLUMNS - 1)
    j = np.clip(band.astype(int), 0, BANDS - 1)
    return i * BANDS + j, 2 * (column - i) - 1, 2 * (band - j) - 1


def _patches(pairs: Pairs, T: FloatArray, sample: Sample, both: PairNoise) -> sparse.csr_array:
    """Return the derivatives by mean and slopes of each patch that the sample falls into."""
    found = places(rays(sample.rows[:, X], both.ahead, both.up)[1])[0]
    _, first = np.unique(found, return_index=True)
    number = {int(found[k]): m for m, k in enumerate(np.sort(first))}  # in order of appearance
    direction = rays(pairs.p, both.ahead, both.up)[1]
    patch, along, upwards = places(direction)
    size = both.patch * np.sum(pairs.J[:, :3] * (direction @ T[:3, :3].T), axis=1)
    column = 3 * np.array([number[k] for k in patch.tolist()])
    row = np.arange(len(patch))
    return sparse.csr_array(
        (
            np.concatenate([size, size * along, size * upwards]),
            (np.tile(row, 3), np.concatenate([column, column + 1, column + 2])),
        ),
        shape=(len(patch), 3 * len(number)),
    )


def _agreed(
    pairs: Pairs, T: FloatArray, mount: FloatArray, both: PairNoise
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives by pose and yaw scale (n, 7) and by the knots (n, 24).

    They are taken at the points on which both readings agree.
    """
    n, q = pairs.J[:, :3], pairs.q
    own, own_way = rays(pairs.p, both.ahead, both.up)
    own_way = own_way @ T[:3, :3].T
    by_own = np.sum(n * own_way, axis=1)
    cosine = np.copysign(np.maximum(np.abs(by_own), MIN_COSINE), by_own)
    farther = -pairs.v_s / (pairs.v_s + pairs.v_t) * pairs.e / cosine
    a = pairs.a + farther[:, None] * own_way
    point = a + T[:3, 3]
    turned = (q[:, 0] * point[:, 1] - q[:, 1] * point[:, 0]) / (q[:, 0] ** 2 + q[:, 1] ** 2)
    swing, turn = (n[:, 1] * v[:, 0] - n[:, 0] * v[:, 1] for v in (a, point))
    g = pairs.yaw_s * swing - (pairs.yaw_t + turned) * turn
    J = np.concatenate([n, np.cross(a, n), g[:, None]], axis=1)
    other, other_way = rays(point, mount[5], mount[7])
    by_other = np.sum(n * other_way, axis=1)
    return J, by_own[:, None] * hats(own + farther) - by_other[:, None] * hats(other)


def hats(ranges: FloatArray) -> FloatArray:
    """Return the share of each knot in a curve that is linear between them (n, 24)."""
    at = np.clip(ranges / SPACING, 0.0, KNOTS - 1)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(KNOTS)))
