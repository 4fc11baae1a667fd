"""Normal equations of two sweeps: projective data association, point-to-plane residuals.

A source surfel at a = R p, moved to p' = a + t, meets the target surfel q on the reading that sees
p'. With n the mean of both normals the residual and its derivatives are

    e = n . (p' - q) + g k,   J = (n, a x n, g),   g = psi_s n . (z x a) - psi_t n . (z x q),

for small (dx, dy, dz, rx, ry, rz) of the source about its own origin (the viewpoint) and for the
relative error k of the yaws psi of both sweeps. Weights are w = area / s^2 (c^2 / (c^2 + e^2 /
s^2))^2 (Geman and McClure) with s^2 the noise of one reading of either scan along the normal.

A range error that the n readings of a patch share adds as much as if only the share 1 / (1 + n
b^2 / s^2) of them counted: it lowers w as a whole.

Yaw jitter moves all surfels of a line together: those of a source line by l_s = n . (z x a) per
radian, those of a target line by l_t = n . (z x q). Where k source lines cross the surface for each
target line, k of them share its error, so to each source line belongs one unknown of unit variance
that moves its residuals by c, c^2 = sigma_s^2 l_s^2 + k sigma_t^2 l_t^2. Marginalised, it takes
h h^T / (1 + sum w c^2) from J^T W J, with h = sum w c J, and likewise from the gradient.

Noise of the normals, of variance nu, and tilts by a range error that changes along the surface fake
the information w nu (B B^T - J J^T), B = (I, [a]x), in directions that the surface leaves free
(Hatleskog and Alexis, arXiv 2410.10784).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.projection import lookup
from reference.scan_arrays import Sample, Target
from reference.surfels import NORMAL_VARIANCE, VARIANCE, N, X
from scan3d_twin.core.types import FloatArray, IntArray

MIN_NORMAL_COSINE = 0.7
"""Least cosine between the normals of a pair (45 deg): others belong to different faces."""
MOST_ALONG_RAY = 3.0
"""A pair may lie this many gates apart along the ray; across the surface one gate."""
MOST_LINES = 20.0
"""Lines of one scan for each of the other at most, for grazing views."""


class Gate(NamedTuple):
    """Gate for correspondences.

    Attributes:
        distance: Most distance along the normal [m].
        robust: c of the weights, in standard deviations.
        cosine: Between the normals, at which the weight of a pair is 0.
    """

    distance: float
    robust: float
    cosine: float = MIN_NORMAL_COSINE


class PairNoise(NamedTuple):
    """Errors of two sweeps beyond the noise of single readings.

    Attributes:
        jitter: Variance of the yaw of a source line [rad2].
        target_jitter: Variance of the yaw of a target line [rad2].
        density: Target line spacing in source line spacings.
        share: Of the readings, those that count in spite of a common bias.
        tilt: Variance of a surface's tilt by a range error that changes along it [rad2].
        patch: Sigma of the range error that a patch of readings shares [m].
        linearity: Sigma of the range error that depends on the range [m].
        offset: Sigma of the range error that all readings share [m].
        correlation: Factor on the variance of a mean of readings correlated along a line.
        height: Sigma of z of a robot on an uneven floor [m].
        lean: Sigma of its roll and pitch [rad].
        ahead: Place of the source's lidar ahead of the yaw axis [m].
        up: Its height [m].
    """

    jitter: float
    target_jitter: float
    density: float
    share: float
    tilt: float
    patch: float
    linearity: float
    offset: float
    correlation: float
    height: float
    lean: float
    ahead: float
    up: float


class Equations(NamedTuple):
    """J^T W J step = -J^T W e, on k entries of x y z rx ry rz, and on the yaw scale as the last.

    Attributes:
        information: J^T W J (k + 1, k + 1).
        lost: What of it the yaw jitter leaves unknown (k + 1, k + 1).
        gradient: J^T W e, less what is lost (k + 1,).
        spurious: Share of the information that noise of the normals fakes (k, k).
        pairs: Number of pairs.
        square: Sum of their squared residuals [m2].
    """

    information: FloatArray
    lost: FloatArray
    gradient: FloatArray
    spurious: FloatArray
    pairs: int
    square: float


class Pairs(NamedTuple):
    """Pairs of surfels, linearised.

    Attributes:
        J: Derivatives by x y z rx ry rz and the yaw scale (n, 7).
        e: Residuals (n,) [m].
        w: Weights (n,) [1/m2].
        own: Error by the yaw of the source line per its sigma (n,) [m].
        nu: Variance of the mean normal (n,) [rad2].
        nu_s: Variance of the source's normal (n,) [rad2].
        nu_t: Variance of the target's normal (n,) [rad2].
        a: Lever arms (n, 3) [m].
        p: Source points, in the source's frame (n, 3) [m].
        q: Target points (n, 3) [m].
        v_s: Variance of the source's reading along the normal (n,) [m2].
        v_t: Variance of the target's (n,) [m2].
        yaw_s: Yaw of the source's reading (n,) [rad].
        yaw_t: Yaw of the target's (n,) [rad].
        lines: Source line of each (n,).
    """

    J: FloatArray
    e: FloatArray
    w: FloatArray
    own: FloatArray
    nu: FloatArray
    nu_s: FloatArray
    nu_t: FloatArray
    a: FloatArray
    p: FloatArray
    q: FloatArray
    v_s: FloatArray
    v_t: FloatArray
    yaw_s: FloatArray
    yaw_t: FloatArray
    lines: IntArray


def linearised(
    target: Target, sample: Sample, T: FloatArray, scale: float, gate: Gate, both: PairNoise
) -> Pairs:
    """Return the pairs within the gate; arguments as of ``normal_equations``."""
    rows, area = sample.rows, float(sample.stride**2)
    a, n_s = rows[:, X] @ T[:3, :3].T, rows[:, N] @ T[:3, :3].T
    moved = a + T[:3, 3]
    at = lookup(target.projection, moved, target.row_of >= 0)
    at = np.where(at >= 0, target.row_of[at], -1)
    met = target.rows[at]
    q, n_t = met[:, X], met[:, N]
    n = n_s + n_t
    length = np.sqrt(np.sum(n * n, axis=1))
    cosine = np.sum(n_s * n_t, axis=1)
    paired = (at >= 0) & (cosine > gate.cosine)
    n /= np.maximum(length, 1e-9)[:, None]
    swing = n[:, 1] * a[:, 0] - n[:, 0] * a[:, 1]  # n . (z x a)
    g = sample.yaws * swing - target.yaws[at] * (n[:, 1] * q[:, 0] - n[:, 0] * q[:, 1])
    e = np.sum(n * (moved - q), axis=1) + g * scale
    paired &= np.abs(e) < gate.distance
    paired &= np.sum((moved - q) ** 2, axis=1) < (MOST_ALONG_RAY * gate.distance) ** 2
    a, n, q, g, e, swing = (v[paired] for v in (a, n, q, g, e, swing))
    v_s, v_t = rows[paired, VARIANCE], met[paired, VARIANCE]
    variance = v_s + v_t
    c2 = gate.robust * gate.robust
    turn = n[:, 1] * q[:, 0] - n[:, 0] * q[:, 1]
    k = _lines_per_line(n, a, q, both.density)
    own = np.sqrt(both.jitter * swing**2 + both.target_jitter * k * turn**2) * np.sign(swing)
    alike = (cosine[paired] - gate.cosine) / (1.0 - gate.cosine)
    w = both.share * area / variance * (c2 / (c2 + e * e / (variance + own * own)) * alike) ** 2
    nu_s, nu_t = rows[paired, NORMAL_VARIANCE], met[paired, NORMAL_VARIANCE]
    nu = (nu_s + nu_t) / 4 + both.tilt
    J = np.concatenate([n, np.cross(a, n), g[:, None]], axis=1)
    yaw_s, yaw_t, lines = sample.yaws[paired], target.yaws[at[paired]], sample.lines[paired]
    p = rows[paired, X]
    return Pairs(J, e, w, own, nu, nu_s, nu_t, a, p, q, v_s, v_t, yaw_s, yaw_t, lines)


def normal_equations(
    target: Target,
    sample: Sample,
    T: FloatArray,
    scale: float,
    gate: Gate,
    both: PairNoise,
    entries: tuple[int, ...],
) -> Equations:
    """Return the normal equations; the method is at the module's head.

    Args:
        target: What the sample is laid on.
        sample: Surfels of the source.
        T: ``T_target_source`` (4, 4).
        scale: Relative error of the yaws of both sweeps.
        gate: Which pairs count.
        both: What the sweeps err by.
        entries: Of x y z rx ry rz, those that are wanted, ascending.
    """
    pairs, area = linearised(target, sample, T, scale, gate, both), float(sample.stride**2)
    J, w, e = pairs.J[:, (*entries, 6)], pairs.w, pairs.e
    information, gradient = (J * w[:, None]).T @ J, J.T @ (w * e)
    lost = np.zeros_like(information)
    if both.jitter > 0 or both.target_jitter > 0:
        lost, taken = _lost(_per_line(w, pairs.own, J, e, pairs.lines), area)
        gradient -= taken
    return Equations(information, lost, gradient, faked(pairs, entries), len(e), float(e @ e))


def faked(pairs: Pairs, entries: tuple[int, ...]) -> FloatArray:
    """Return the information on ``entries`` that noise of the normals adds (k, k)."""
    weights, J = pairs.w * pairs.nu, pairs.J[:, entries]
    return swung(weights, pairs.a)[np.ix_(entries, entries)] - (J * weights[:, None]).T @ J


def _lines_per_line(n: FloatArray, a: FloatArray, q: FloatArray, density: float) -> FloatArray:
    """Return how many source lines cross the surface for each target line (m,).

    A surface of normal n seen from a distance r has |n . r| / r^2 of yaw per metre.
    """
    source = np.abs(n[:, 0] * a[:, 0] + n[:, 1] * a[:, 1]) * (q[:, 0] ** 2 + q[:, 1] ** 2)
    target = np.abs(n[:, 0] * q[:, 0] + n[:, 1] * q[:, 1]) * (a[:, 0] ** 2 + a[:, 1] ** 2)
    return np.clip(density * source / np.maximum(target, 1e-9), 1 / MOST_LINES, MOST_LINES)


def _per_line(
    w: FloatArray, own: FloatArray, J: FloatArray, e: FloatArray, line: IntArray
) -> FloatArray:
    """Return sum w c J, sum w c e and sum w c^2 of each source line (n, k + 3)."""
    columns = np.concatenate([J, e[:, None], own[:, None]], axis=1) * (w * own)[:, None]
    starts = np.flatnonzero(np.diff(line, prepend=-1))
    if len(starts) == 0:
        return np.zeros((0, columns.shape[1]))
    return np.asarray(np.add.reduceat(columns, starts, axis=0))


def _lost(per_line: FloatArray, area: float) -> tuple[FloatArray, FloatArray]:
    """Return the information and gradient lost to the yaw error of each line.

    A sampled line stands for sqrt(area) lines, each with an error of its own.
    """
    h, r, s = per_line[:, :-2], per_line[:, -2], per_line[:, -1]
    share = 1.0 / (np.sqrt(area) + s)
    return (h * share[:, None]).T @ h, h.T @ (share * r)


def spurious_information(weights: FloatArray, a: FloatArray, J: FloatArray) -> FloatArray:
    """Return sum w nu (B B^T - J J^T) (6, 6)."""
    return swung(weights, a) - (J * weights[:, None]).T @ J


def swung(weights: FloatArray, a: FloatArray) -> FloatArray:
    """Return sum w nu B B^T (6, 6)."""
    result = np.zeros((6, 6))
    result[:3, :3] = np.eye(3) * weights.sum()
    x, y, z = weights @ a
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[3:, :3], result[:3, 3:] = cross, cross.T
    outer = (a * weights[:, None]).T @ a
    result[3:, 3:] = np.eye(3) * np.trace(outer) - outer
    return result
