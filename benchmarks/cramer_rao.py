"""The Cramer-Rao bound of the registration of a pair of simulated sweeps."""

from __future__ import annotations

import numpy as np
from registration_data import LINES, Lines, Noise, pair

from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.pose_prior import PLANAR, predict_rmse
from scan3d_twin.core.registration.surfels.grid import extract_surfels
from scan3d_twin.core.registration.surfels.scan_noise import ScanNoise


def cramer_rao(scene: str, sigma: float, seed: int = 0, lines: Lines = LINES["regular"]) -> float:
    """Return the bound of the RMS point error [m]: the inverse information of noise-free scans."""
    data = pair(scene, Noise(1e-6), seed, lines=lines)
    noise = ScanNoise(sigma, 0.0)
    target, source = (
        extract_surfels(data.target, noise=noise),
        extract_surfels(data.source, noise=noise),
    )
    equations = linearise(target, source, 1, data.truth.matrix(), 0.0, Gate(0.03, 1e3))
    rows = np.ix_(PLANAR, PLANAR)
    covariance = np.zeros((6, 6))
    covariance[rows] = np.linalg.inv(equations.information[:6, :6][rows])
    points = data.source.points[np.isfinite(data.source.ranges)]
    return predict_rmse(data.truth.rotate(points), covariance)
