"""The normal equations of two surfel grids: projective association, symmetric point to plane.

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

from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.registration.compiled import compiled
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.surfel_grid import SurfelGrid
from scan3d_twin.core.registration.surfels import NORMAL_VARIANCE, VARIANCE, N, X
from scan3d_twin.core.types import FloatArray, IntArray

MIN_NORMAL_COSINE = 0.7
"""Normals that differ by more (45 deg) are of different faces."""
MOST_ALONG_RAY = 3.0
"""A pair may lie this many gates apart along the ray; across the surface one gate."""
MOST_LINES = 20.0
"""Lines of one scan for each of the other at most, for grazing views."""


@dataclass(frozen=True, slots=True)
class Gate:
    """Which pairs count.

    Attributes:
        distance: Most distance along the normal [m].
        robust: c of the weights, in standard deviations.
    """

    distance: float
    robust: float


@dataclass(frozen=True, slots=True)
class Equations:
    """J^T W J step = -J^T W e, in the order x y z rx ry rz and yaw scale.

    Attributes:
        information: J^T W J (7, 7).
        lost: What of it the yaw jitter leaves unknown (7, 7).
        gradient: J^T W e, less what is lost (7,).
        faked: Share of the information that noise of the normals fakes (6, 6).
        pairs: Number of pairs.
        square: Sum of their squared residuals [m2].
    """

    information: FloatArray
    lost: FloatArray
    gradient: FloatArray
    faked: FloatArray
    pairs: int
    square: float


def linearise(
    target: SurfelGrid, source: SurfelGrid, stride: int, T: FloatArray, scale: float, gate: Gate
) -> Equations:
    """Return the normal equations at the pose ``T`` (4, 4) and the yaw scale error ``scale``."""
    sample, projection = source.sample(stride), target.projection
    run = compiled("normal_equations") or normal_equations
    limits = np.array(
        [
            gate.distance,
            gate.robust,
            sample.stride**2,
            scale,
            source.noise.yaw_sigma**2,
            target.noise.yaw_sigma**2,
            target.line_spacing / source.line_spacing,
            2.0 / (source.inflation + target.inflation),
            (source.noise.tilt_variance + target.noise.tilt_variance) / 4,
        ]
    )
    yaws = target.image.yaws.reshape(-1)
    result = run(
        target.table.reshape(-1, 8), yaws, target.middle_yaw,
        projection.lines, projection.beams, projection.offsets, projection.mount,
        sample.rows, sample.yaws, sample.lines, np.ascontiguousarray(T[:3]), limits,
    )  # fmt: skip
    return Equations(*result)


def normal_equations(
    table: FloatArray,
    yaws: FloatArray,
    middle_yaw: float,
    lines: IntArray,
    beams: IntArray,
    offsets: FloatArray,
    mount: FloatArray,
    rows: FloatArray,
    source_yaws: FloatArray,
    source_lines: IntArray,
    T: FloatArray,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, int, float]:
    """Return the fields of ``Equations``; the method is at the module's head.

    Args:
        table: The target's surfels (n, 8).
        yaws: At which each was measured (n,) [rad].
        middle_yaw: Of the target's sweep [rad].
        lines: With ``beams``, ``offsets`` and ``mount`` the target's ``Projection``.
        beams: See there.
        offsets: See there.
        mount: See there.
        rows: The source's surfels (m, 8).
        source_yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        source_lines: Line of each (m,), ascending.
        T: ``T_target_source`` (3, 4).
        limits: Gate distance, c, area, yaw scale error, variances of the source's and the target's
            yaw jitter, target line spacing in source line spacings, share of
            the readings that count in spite of a common bias, variance of the tilt by it (9,).
    """
    distance, robust, area, scale, jitter, target_jitter, density, share, tilt = limits
    a, n_s = rows[:, X] @ T[:, :3].T, rows[:, N] @ T[:, :3].T
    moved = a + T[:, 3]
    index = Projection(lines, beams, offsets, mount).lookup(moved, table[:, VARIANCE])
    q, n_t = table[index, X], table[index, N]
    n = n_s + n_t
    length = np.sqrt(np.sum(n * n, axis=1))
    paired = (index >= 0) & (table[index, VARIANCE] > 0) & (rows[:, VARIANCE] > 0)
    paired &= np.sum(n_s * n_t, axis=1) > MIN_NORMAL_COSINE
    n /= np.maximum(length, 1e-9)[:, None]
    swing = n[:, 1] * a[:, 0] - n[:, 0] * a[:, 1]  # n . (z x a)
    g = source_yaws * swing - (yaws[index] - middle_yaw) * (n[:, 1] * q[:, 0] - n[:, 0] * q[:, 1])
    e = np.sum(n * (moved - q), axis=1) + g * scale
    paired &= np.abs(e) < distance
    paired &= np.sum((moved - q) ** 2, axis=1) < (MOST_ALONG_RAY * distance) ** 2
    a, n, q, g, e, swing = (v[paired] for v in (a, n, q, g, e, swing))
    variance = rows[paired, VARIANCE] + table[index[paired], VARIANCE]
    c2 = robust * robust
    turn = n[:, 1] * q[:, 0] - n[:, 0] * q[:, 1]
    k = _lines_per_line(n, a, q, density)
    own = np.sqrt(jitter * swing**2 + target_jitter * k * turn**2) * np.sign(swing)
    w = share * area / variance * (c2 / (c2 + e * e / (variance + own * own))) ** 2
    J = np.concatenate([n, np.cross(a, n), g[:, None]], axis=1)
    information, gradient, lost = (J * w[:, None]).T @ J, J.T @ (w * e), np.zeros((7, 7))
    if jitter > 0 or target_jitter > 0:
        lost, taken = _lost(_per_line(w, own, J, e, source_lines[paired]), area)
        gradient -= taken
    nu = (rows[paired, NORMAL_VARIANCE] + table[index[paired], NORMAL_VARIANCE]) / 4 + tilt
    return information, lost, gradient, faked_information(w * nu, a, J[:, :6]), len(e), float(e @ e)


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
    """Return sum w c J (7), sum w c e and sum w c^2 of each source line (k, 9)."""
    columns = np.concatenate([J, e[:, None], own[:, None]], axis=1) * (w * own)[:, None]
    starts = np.flatnonzero(np.diff(line, prepend=-1))
    if len(starts) == 0:
        return np.zeros((0, 9))
    return np.asarray(np.add.reduceat(columns, starts, axis=0))


def _lost(per_line: FloatArray, area: float) -> tuple[FloatArray, FloatArray]:
    """Return what the yaw error of each line takes from information (7, 7) and gradient (7,).

    A sampled line stands for sqrt(area) lines, each with an error of its own.
    """
    h, r, s = per_line[:, :7], per_line[:, 7], per_line[:, 8]
    share = 1.0 / (np.sqrt(area) + s)
    return (h * share[:, None]).T @ h, h.T @ (share * r)


def faked_information(weights: FloatArray, a: FloatArray, J: FloatArray) -> FloatArray:
    """Return sum w nu (B B^T - J J^T) (6, 6)."""
    result = np.zeros((6, 6))
    result[:3, :3] = np.eye(3) * weights.sum()
    x, y, z = weights @ a
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[3:, :3], result[:3, 3:] = cross, cross.T
    outer = (a * weights[:, None]).T @ a
    result[3:, 3:] = np.eye(3) * np.trace(outer) - outer
    return result - (J * weights[:, None]).T @ J
