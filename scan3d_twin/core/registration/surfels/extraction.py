"""Surfels of a range image: a plane fitted around every reading, with its noise.

A plane m . P = 1 seen along the beam P = o + r d, with o the lidar's position on its circle about
the yaw axis, obeys, with the inverse range q = 1 / r,

    q = m . x,    x = P / r = d + q o,

which is linear in m, with noise of q that is constant over a small window. The least-squares
solution m = A^-1 b, A = sum x x^T, b = sum x q, is therefore not biased towards the rays, unlike a
plane through the points (Badino et al., ICRA 2011, for o = 0). All sums over windows come from one
summed-area table of 11 moments. P is taken from the height of the lidar on the yaw axis: no surface
in view passes there, while the floor passes through the origin of ``base``, where no m describes
it. Each reading takes its largest window over which the plane fits:

    rss <= s^2 (n - 3) (1 + 0.7 sqrt(2 / (n - 3))),  s = q |m| sigma_n,   sigma_n = |n . d| sigma_r,

with n = m / |m|. Beyond 60 deg of incidence the reading must also lie near the middle of its
window: at the limb of a round body windows reach to one side only, and the normal of a plane that
still fits leans by more than noise explains. If each line also has a yaw error of sigma_psi, its
readings in a window of L lines move together along the normal, by l = n . (z x P) per radian, which
adds up to

    n q^2 |m|^2 l^2 sigma_psi^2 (1 + 0.7 sqrt(2 / L)).

The noise of the normal follows from that of m: cov(n) = v / |m|^2 (I - n n^T) A^-1 (I - n n^T); its
mean variance over the two tangents is kept. As noise is correlated along a line, with the factor c
on the variance of a mean, and the yaw error of a line moves all its n / L readings together,

    v = c s^2 + (n / L) (q |m| l sigma_psi)^2.

The plane lies inside of a round body, by as much as a range error that grows with the curvature.
The readings of the next smaller window lie on the parallel plane (1 + a) m in the least squares,
and the middle of a paraboloid is farther off than their mean by the gain g = 1 / (1 - w), with w
the ratio of the windows' variances, its mean over lines and beams:

    a = (sum q m . x) / sum (m . x)^2 - 1        over the smaller window,
    var(a) = c s^2 (1 / sum_inner (m . x)^2 - 1 / sum (m . x)^2)
             + (|m| l sigma_psi)^2 (1 / L_inner - 1 / L).

What exceeds the noise counts, a share of 1 - var(a) / a^2 or 0 (the positive part of James and
Stein, 1961): the surfel lies on the plane (1 + g a share) m. On flat ones two of three stay.

``native/surfels.h`` computes the surfels.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    IntArray,
    RangeImage,
    SmallIntArray,
    read_only,
)

X, N, VARIANCE, NORMAL_VARIANCE = np.s_[0:3], np.s_[3:6], 6, 7
"""Columns of a surfel: its point on the central beam [m], its unit normal towards the lidar, the
variance of one reading along the normal by range noise [m2], the variance of the normal [rad2]."""
UNKNOWN_RAY, EMPTY_RAY, SURFACE_RAY = 0, 1, 2
"""State of a reading's ray: unknown, empty, or ending on a surface."""


class Beams(NamedTuple):
    """The beams of a lidar on its mount.

    Attributes:
        directions: Unit vectors in ``base``: (n_beams, 3), or (n_lines, n_beams, 3) where the lines
            of a sweep have elevations of their own.
        lever: Position of the lidar in ``base`` (3,) [m].
        spacing: Typical angle between two beams [rad].
    """

    directions: FloatArray
    lever: FloatArray
    spacing: float

    @staticmethod
    def of(image: RangeImage) -> Beams:
        """Return the beams of a sweep, which all regular sweeps of a lidar share.

        Raises:
            ConfigError: Elevations or mount are not finite.
        """
        own, T_base_lidar = image.elevations, image.T_base_lidar.tobytes()
        usual = _compute_beams(read_only(image.spec.elevations).tobytes(), T_base_lidar)
        if own is None:
            return usual
        directions = _compute_own_directions(read_only(own).tobytes(), T_base_lidar)
        return usual._replace(directions=directions.reshape(*own.shape, 3))

    def at(self, lines: IntArray, beams: IntArray) -> FloatArray:
        """Return the directions of some readings (n, 3), by their lines (n,) and beams (n,)."""
        every = self.directions
        return np.asarray(every[beams] if every.ndim == 2 else every[lines, beams])


@lru_cache(maxsize=16)
def _compute_beams(elevations: bytes, T_base_lidar: bytes) -> Beams:
    e, T = np.frombuffer(elevations), np.frombuffer(T_base_lidar).reshape(4, 4)
    spacing = float(np.median(np.abs(np.diff(e))))
    return Beams(_compute_directions(e, T), read_only(T[:3, 3]), spacing)


@lru_cache(maxsize=4)
def _compute_own_directions(elevations: bytes, T_base_lidar: bytes) -> FloatArray:
    """Return ``_compute_directions`` of the readings of a sweep; large, and used a few times."""
    e, T = np.frombuffer(elevations), np.frombuffer(T_base_lidar).reshape(4, 4)
    return _compute_directions(e, T)


def _compute_directions(e: FloatArray, T: FloatArray) -> FloatArray:
    """Return unit vectors in ``base`` (n, 3) at elevations ``e`` (n,) [rad], on the mount ``T``."""
    if not (np.all(np.isfinite(e)) and np.all(np.isfinite(T))):
        raise ConfigError("range image: elevations and T_base_lidar must be finite")
    return read_only(np.cos(e)[:, None] * T[:3, 0] + np.sin(e)[:, None] * T[:3, 2])


def make_native_sweep(image: RangeImage) -> native.Sweep:
    """Return the readings of a sweep as the engine takes them."""
    beams = Beams.of(image)
    return native.Sweep(
        n_lines=image.n_lines,
        n_beams=image.spec.n_beams,
        stride=image.spec.n_beams,
        ranges=read_only(image.ranges),
        yaws=read_only(image.yaws),
        rays=beams.directions,
        ray_stride=0 if beams.directions.ndim == 2 else 3 * image.spec.n_beams,
        lever=beams.lever,
        sigmas=None,
        beam_spacing=beams.spacing,
        max_range=image.spec.max_range,
    )


def fit_surfels(
    sweep: native.Sweep,
    valid: BoolArray,
    keep: BoolArray,
    noise: FloatArray,
    windows: IntArray,
) -> tuple[FloatArray, FloatArray, SmallIntArray]:
    """Return the surfels of a sweep; the module's head describes the method.

    Args:
        sweep: The readings.
        valid: Whether a reading is a distance (n_lines, n_beams).
        keep: Whether a reading gets a surfel (n_lines, n_beams).
        noise: Range sigma at 0 m [m], its growth per metre, sigma of a line's yaw [rad], factor on
            the variance of a mean of readings correlated along a line (4,).
        windows: Half sizes in lines and beams, largest first (k, 2).

    Returns:
        Surfels (m, 8) line by line, columns as above; the yaw at which each was measured (m,)
        [rad]; and the row of each reading's surfel (n_lines, n_beams), -1 where no plane fits.
    """
    rows = np.empty((np.count_nonzero(keep), 8))
    yaws, index = np.empty(len(rows)), np.full(valid.shape, -1, dtype=np.int32)
    n = engine.fit_surfels(sweep, valid, keep, noise, windows, len(windows), rows, yaws, index)
    if n < 0:
        raise MemoryError
    return rows[:n], yaws[:n], index


def classify_rays(index: SmallIntArray, valid: BoolArray) -> native.ByteArray:
    """Return the state of each reading's ray (n_lines * n_beams,).

    A ray with a surfel is a ``SURFACE_RAY``. It is an ``EMPTY_RAY`` if no reading within two lines
    and beams returned, as single readings drop out; all others are an ``UNKNOWN_RAY``.
    """
    known = np.empty(index.size, dtype=np.uint8)
    if engine.classify_rays(index, valid, *index.shape, known) < 0:
        raise MemoryError
    return known
