"""Normal equations of two sweeps: projective data association, symmetric point-to-plane residuals.

A source surfel at a = R p, moved to p' = a + t, is paired with the target surfel q on the reading
that sees p'. With n the mean of both normals the residual and its derivatives are

    e = n . (p' - q) + g k,   J = (n, a x n, g),   g = psi_s n . (z x a) - psi_t n . (z x q),

for small (dx, dy, dz, rx, ry, rz) of the source about its own origin (the viewpoint) and for the
relative error k of the yaws psi of both sweeps. Weights are w = area / s^2 (c^2 / (c^2 + e^2 /
s^2))^2 u^2 (Geman and McClure) with s^2 the noise of one reading of either scan along the normal.
Where windows reach round a corner that one sweep sees and the other does not, one of both normals
leans, and such pairs move the pose alike in every step of a tour. Hence u = (cos b - c_0) / (1 -
c_0), with b the angle between the normals: it is 0 at 66 deg while the pose may be off, and at 30
deg at the least gate; wider pairs do not count.

Range bias: an error b that the n readings of a patch share has the effect that only the share
1 / (1 + n b^2 / s^2) of them counts, so it scales all w.

Yaw jitter moves all surfels of a line together: those of a source line by l_s = n . (z x a) per
radian, those of a target line by l_t = n . (z x q). Where k source lines cross the surface for each
target line, k of them share its error, so each source line has one unknown of unit variance that
moves its residuals by c, c^2 = sigma_s^2 l_s^2 + k sigma_t^2 l_t^2. Marginalising it subtracts
h h^T / (1 + sum w c^2) from J^T W J, with h = sum w c J, and a matching term from the gradient.

Spurious information: noise of the normals, of variance nu, and tilts by a range error that changes
along the surface add w nu (B B^T - J J^T), B = (I, [a]x), in directions that the surface leaves
free (Hatleskog and Alexis, arXiv 2410.10784). ``native/pairs.h`` computes all of this.

Stretched windows: nu is the mean over both tangents. A window that a ray d meets at an incidence of
cosine b is 1 / b times as long along the ray's trace as across it, so that the normal varies by
2 nu / (1 + b^2) about the trace, at most twice the mean, and by b^2 times that across it. Where a
direction has less than four times its spurious information, this decides whether it is determined:
a floor far ahead fakes twice as much of a turn. There each of a pair's two normals adds

    w nu / (4 (1 + b^2)) (J_v J_v^T - J_u J_u^T),   u = d - (n . d) n,  v = n x d,  J_x = (x, a x x)

to the spurious information (``native/stretched_windows.h``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import STATE, engine
from scan3d_twin.core.registration.shared_errors import combine_shared_errors
from scan3d_twin.core.registration.surfels.grid import SurfelGrid
from scan3d_twin.core.types import FloatArray

MIN_NORMAL_COSINE = 0.7
"""Least cosine between the normals of a pair (45 deg) where pairs are only counted."""


class Gate(NamedTuple):
    """Gate for correspondences.

    Attributes:
        distance: Largest distance along the normal [m].
        robust: Scale c of the robust kernel, in standard deviations.
        cosine: Cosine between the normals at which the weight of a pair is 0.
    """

    distance: float
    robust: float
    cosine: float = MIN_NORMAL_COSINE


class Equations(NamedTuple):
    """Normal equations J^T W J step = -J^T W e of x y z rx ry rz and, last, the yaw scale.

    Attributes:
        information: J^T W J (7, 7).
        lost: Information lost to yaw jitter, to be subtracted (7, 7).
        gradient: J^T W e, with the jitter marginalised (7,).
        spurious: Information that noise of the normals adds (6, 6).
        pairs: Number of correspondences.
        square: Sum of their squared residuals [m2].
    """

    information: FloatArray
    lost: FloatArray
    gradient: FloatArray
    spurious: FloatArray
    pairs: int
    square: float


def combine_noise(target: SurfelGrid, source: SurfelGrid) -> native.PairNoise:
    """Return the errors of two sweeps beyond the noise of single readings.

    ``jitter`` and ``target_jitter`` are the yaw variances of a line [rad2], ``density`` is the
    target's line spacing per spacing of the source, ``share`` the share of the readings that count
    in spite of a common bias, ``tilt`` the variance of a surface's tilt by a range error that
    changes along it [rad2]; ``combine_shared_errors`` describes the others.
    """
    return native.PairNoise(
        jitter=source.noise.yaw_sigma**2,
        target_jitter=target.noise.yaw_sigma**2,
        density=target.line_spacing / source.line_spacing,
        share=2.0 / (source.inflation + target.inflation),
        tilt=(source.noise.tilt_variance + target.noise.tilt_variance) / 4,
        **combine_shared_errors(target, source),
    )


def linearise(
    target: SurfelGrid, source: SurfelGrid, stride: int, T: FloatArray, scale: float, gate: Gate
) -> Equations:
    """Return the normal equations of all six entries of the pose and the yaw scale.

    Args:
        target: Sweep that the source is registered to.
        source: The other sweep.
        stride: Every ``stride``-th of its surfels along lines and beams takes part.
        T: ``T_target_source`` (4, 4).
        scale: Relative error of the yaws.
        gate: Gate for correspondences.
    """
    found = native.Equations()
    nuisances = np.array([scale, 0.0])
    every = native.Prior(n_entries=6, entries=range(6), n_nuisances=1)
    if engine.build_equations(
        target.target, source.sample(stride).value, np.ascontiguousarray(T), nuisances,
        native.Gate(**gate._asdict()),
        combine_noise(target, source), every, found,
    ) < 0:  # fmt: skip
        raise MemoryError

    # Cut out the entries in use.
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
    """Return sum w nu (B B^T - J J^T) (6, 6), the information that noise of the normals adds.

    Args:
        weights: w nu of each pair (n,).
        a: Lever arms (3, n) [m].
        J: Jacobian (6, n).
    """
    result = np.zeros((6, 6))
    result[:3, :3] = np.eye(3) * weights.sum()
    x, y, z = a @ weights
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    result[3:, :3], result[:3, 3:] = cross, cross.T
    outer = (a * weights) @ a.T
    result[3:, 3:] = np.eye(3) * np.trace(outer) - outer
    return result - (J * weights) @ J.T


def compute_jacobian(a: FloatArray, n: FloatArray) -> FloatArray:
    """Return the point-to-plane Jacobian (n, a x n) (6, m) of lever arms a and normals n (3, m)."""
    (ax, ay, az), (nx, ny, nz) = a, n
    return np.stack([nx, ny, nz, ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx])
