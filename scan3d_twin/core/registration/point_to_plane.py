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

Noise of the normals, of variance nu, and tilts by a range error that changes along the surface add
the spurious information w nu (B B^T - J J^T), B = (I, [a]x), in directions that the surface leaves
free (Hatleskog and Alexis, arXiv 2410.10784). ``native/pairs.h`` computes all of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import STATE, engine
from scan3d_twin.core.registration.surfel_grid import SurfelGrid
from scan3d_twin.core.types import FloatArray

MIN_NORMAL_COSINE = 0.7
"""Normals that differ by more (45 deg) are of different faces."""


class Gate(NamedTuple):
    """Which pairs count.

    Attributes:
        distance: Most distance along the normal [m].
        robust: c of the weights, in standard deviations.
    """

    distance: float
    robust: float


class Equations(NamedTuple):
    """J^T W J step = -J^T W e, on x y z rx ry rz and on the yaw scale as the last.

    Attributes:
        information: J^T W J (7, 7).
        lost: What of it the yaw jitter leaves unknown (7, 7).
        gradient: J^T W e, less what is lost (7,).
        spurious: Part of the information that noise of the normals adds (6, 6).
        pairs: Number of pairs.
        square: Sum of their squared residuals [m2].
    """

    information: FloatArray
    lost: FloatArray
    gradient: FloatArray
    spurious: FloatArray
    pairs: int
    square: float


def pair_noise(target: SurfelGrid, source: SurfelGrid) -> native.PairNoise:
    """Return what two sweeps err by beside the noise of single readings.

    ``jitter`` and ``target_jitter`` are the variances of the yaw of a line [rad2], ``density`` the
    target's line spacing in those of the source, ``share`` that of the readings which count in
    spite of a common bias, and ``tilt`` the variance of a surface's tilt by a range error that
    changes along it [rad2].
    """
    return native.PairNoise(
        jitter=source.noise.yaw_sigma**2,
        target_jitter=target.noise.yaw_sigma**2,
        density=target.line_spacing / source.line_spacing,
        share=2.0 / (source.inflation + target.inflation),
        tilt=(source.noise.tilt_variance + target.noise.tilt_variance) / 4,
    )


def linearise(
    target: SurfelGrid, source: SurfelGrid, stride: int, T: FloatArray, scale: float, gate: Gate
) -> Equations:
    """Return the normal equations of all six entries and the scale.

    Args:
        target: What the source is laid on.
        source: Every ``stride``-th of its surfels takes part.
        stride: Along lines and beams.
        T: ``T_target_source`` (4, 4).
        scale: Relative error of the yaws.
        gate: Which pairs count.
    """
    found = native.Equations()
    nuisances = np.array([scale, 0.0])
    every = native.Prior(n_entries=6, entries=range(6), n_nuisances=1)
    if engine.equations(
        target.target, source.sample(stride).value, np.ascontiguousarray(T), nuisances,
        native.Gate(distance=gate.distance, robust=gate.robust), pair_noise(target, source), every,
        found,
    ) < 0:  # fmt: skip
        raise MemoryError
    whole = (STATE, STATE)
    return Equations(
        found.numbers("information", *whole)[:7, :7],
        found.numbers("lost", *whole)[:7, :7],
        found.numbers("gradient", 7),
        found.numbers("spurious", *whole)[:6, :6],
        found.pairs,
        found.square,
    )


def spurious_information(weights: FloatArray, a: FloatArray, J: FloatArray) -> FloatArray:
    """Return sum w nu (B B^T - J J^T) (6, 6), what noise of the normals adds to the information.

    Args:
        weights: w nu of each pair (n,).
        a: Lever arms (3, n) [m].
        J: Derivatives (6, n).
    """
    result = np.zeros((6, 6))
    result[:3, :3] = np.eye(3) * weights.sum()
    x, y, z = a @ weights
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[3:, :3], result[:3, 3:] = cross, cross.T
    outer = (a * weights) @ a.T
    result[3:, 3:] = np.eye(3) * np.trace(outer) - outer
    return result - (J * weights) @ J.T


def pair_derivatives(a: FloatArray, n: FloatArray) -> FloatArray:
    """Return (n, a x n) (6, m) of lever arms ``a`` and normals ``n`` (3, m)."""
    (ax, ay, az), (nx, ny, nz) = a, n
    return np.stack([nx, ny, nz, ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx])
