"""Prediction of the surface beyond the edge of a scan (the paper's future work, section 7).

In the top view the surface is a profile: depth v over the way u along it. Three predictors carry it
on: a plane through the strip at the edge, a quadratic patch there (Kriegel et al., Journal of
Real-Time Image Processing 10, 2015), and the profile itself shifted by its period. Which of them is
believed, and how far, the scan itself tells: the last quarter of it is hidden and predicted from
the rest, the predictor with the smallest error wins, and that error is its sigma. What is predicted
places the next view; it never counts as overlap, for registration must rest on what was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import FloatArray, Pose2

HIDDEN = 0.25
"""Share of the lines that the hold-out hides; as much of the profile is predicted at most."""
STRIP = 0.30
"""Width of the strip at the edge that a patch is fitted to [m], an assumption."""
STEP = 0.01
"""Spacing of the profile and of the prediction [m]: that of the lines at 1 m."""
MIN_WIDTH = 0.40
"""A narrower profile has nothing to spare for a hold-out [m]."""
MIN_PERIOD = 0.08
"""Shortest period that is looked for [m]: eight spacings."""

Predictor = Callable[[FloatArray, int], FloatArray]
"""Returns the next (m,) depths of a profile (n,), both ``STEP`` apart [m]."""


@dataclass(frozen=True)
class Prediction:
    """The surface beyond the edge.

    Attributes:
        name: Of the predictor that won the hold-out.
        sigma: Root mean square error of its hold-out [m].
        points: Top view of what follows the last point (m, 2), ``STEP`` apart along the way [m].
    """

    name: str
    sigma: float
    points: FloatArray


def predict(points: FloatArray) -> Prediction | None:
    """Return what follows ``points``, or None if they are too few to tell.

    Args:
        points: Top view (n, 2) of a surface, in the order of the robot's travel [m].
    """
    if len(points) < 8 or not np.all(np.isfinite(points)):
        return None
    frame = _along(points)
    profile = _resampled(frame.inverse().apply(points))
    hidden = round(HIDDEN * len(profile))
    if len(profile) * STEP < MIN_WIDTH:
        return None
    known, truth = profile[:-hidden], profile[-hidden:]
    errors = {
        name: float(np.sqrt(np.mean((predictor(known, hidden) - truth) ** 2)))
        for name, predictor in PREDICTORS.items()
    }
    name = min(errors, key=lambda each: errors[each])
    v = PREDICTORS[name](profile, hidden)
    u = (len(profile) + np.arange(hidden)) * STEP
    return Prediction(name, errors[name], frame.apply(np.column_stack([u, v])))


def plane(profile: FloatArray, n: int) -> FloatArray:
    """Return the plane through the strip at the edge, carried on."""
    return _patch(profile, n, 1)


def quadratic(profile: FloatArray, n: int) -> FloatArray:
    """Return the quadratic patch through the strip at the edge, carried on."""
    return _patch(profile, n, 2)


def period(profile: FloatArray, n: int) -> FloatArray:
    """Return the profile shifted by its period: the shift at which it differs least from itself.

    At least half of the profile has to lie on itself, so that the period shows twice.
    """
    shifts = range(round(MIN_PERIOD / STEP), len(profile) // 2 + 1)
    differences = [float(np.var(profile[k:] - profile[:-k])) for k in shifts]
    k = shifts[int(np.argmin(differences))]
    drift = float(np.mean(profile[k:] - profile[:-k]))
    ahead = np.arange(n)
    return np.asarray(profile[len(profile) - k + ahead % k] + drift * (1 + ahead // k))


PREDICTORS: Mapping[str, Predictor] = {"plane": plane, "quadratic": quadratic, "period": period}
"""In this order of preference where two are equally good."""


def _patch(profile: FloatArray, n: int, degree: int) -> FloatArray:
    strip = profile[-round(STRIP / STEP) :]
    u = np.arange(len(strip)) * STEP
    fit = np.polynomial.Polynomial.fit(u, strip, degree)
    return np.asarray(fit((len(strip) + np.arange(n)) * STEP))


def _along(points: FloatArray) -> Pose2:
    """Return the frame of the profile: origin at the first point, x towards the last one."""
    way = points[-1] - points[0]
    return Pose2(float(points[0, 0]), float(points[0, 1]), float(np.arctan2(way[1], way[0])))


def _resampled(local: FloatArray) -> FloatArray:
    """Return the depth (n,) every ``STEP`` along the way; where it turns back, of the mean."""
    order = np.argsort(local[:, 0], kind="stable")
    u, index = np.unique(local[order, 0], return_inverse=True)
    v = np.bincount(index, local[order, 1]) / np.bincount(index)
    return np.asarray(np.interp(np.arange(0.0, u[-1] + STEP / 2, STEP), u, v))
