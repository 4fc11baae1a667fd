"""Prediction of the surface beyond the edge of a scan (the paper's future work, section 7).

In the top view the surface is a profile: depth v over the distance u along it. Three predictors
extend it: a plane through the strip at the edge, a quadratic patch there (Kriegel et al., Journal
of Real-Time Image Processing 10, 2015), and the profile itself shifted by its period. A hold-out
chooses between them: the last quarter of the scan is predicted from the rest, the predictor with
the smallest error wins, and that error is the sigma of its prediction. Predicted surface places the
next view but never counts as overlap, as registration must rely on what was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.types import FloatArray, Pose2

HOLD_OUT_SHARE = 0.25
"""Share of the profile that is held out, and length of the prediction as a share of the profile."""
STRIP_WIDTH = 0.30
"""Width of the strip at the edge to which a patch is fitted [m]; an assumption."""
PROFILE_STEP = 0.01
"""Spacing of the profile and of the prediction [m]: the spacing of lines at 1 m."""
MIN_PROFILE_WIDTH = 0.40
"""Width below which a profile is too narrow for a hold-out [m]."""
MIN_PERIOD = 0.08
"""Shortest period that is searched for [m]: eight spacings."""

Predictor = Callable[[FloatArray, int], FloatArray]
"""Returns the next m depths of a profile (n,), both ``PROFILE_STEP`` apart [m]."""


@dataclass(frozen=True)
class Prediction:
    """The predicted surface beyond the edge.

    Attributes:
        name: Name of the predictor that won the hold-out.
        sigma: Root mean square error of its hold-out [m].
        points: Top view of the surface after the last point, ``PROFILE_STEP`` apart (m, 2) [m].
    """

    name: str
    sigma: float
    points: FloatArray


def predict_surface(points: FloatArray) -> Prediction | None:
    """Return the surface that follows ``points``, or None if they are too few.

    Args:
        points: Top view (n, 2) of a surface, in the order of the robot's travel [m].
    """
    if len(points) < 8 or not np.all(np.isfinite(points)):
        return None

    # Resample the profile
    frame = _profile_frame(points)
    profile = _resample(frame.inverse().apply(points))
    hidden = round(HOLD_OUT_SHARE * len(profile))
    if len(profile) * PROFILE_STEP < MIN_PROFILE_WIDTH:
        return None

    # Choose the predictor by hold-out
    known, truth = profile[:-hidden], profile[-hidden:]
    errors = {
        name: float(np.sqrt(np.mean((predictor(known, hidden) - truth) ** 2)))
        for name, predictor in PREDICTORS.items()
    }
    name = min(errors, key=lambda each: errors[each])

    # Predict from the whole profile
    v = PREDICTORS[name](profile, hidden)
    u = (len(profile) + np.arange(hidden)) * PROFILE_STEP
    return Prediction(name, errors[name], frame.apply(np.column_stack([u, v])))


def extend_plane(profile: FloatArray, n: int) -> FloatArray:
    """Return the profile (n,) after a plane through the strip at its end."""
    return _extend_polynomial(profile, n, 1)


def extend_quadratic(profile: FloatArray, n: int) -> FloatArray:
    """Return the profile (n,) after a quadratic patch through the strip at its end."""
    return _extend_polynomial(profile, n, 2)


def extend_period(profile: FloatArray, n: int) -> FloatArray:
    """Return the profile (n,) after its end, repeated by its period.

    The period is the shift at which the profile differs least from itself. At least half of it must
    overlap the shifted one, so that the period shows twice.
    """
    shifts = range(round(MIN_PERIOD / PROFILE_STEP), len(profile) // 2 + 1)
    differences = [float(np.var(profile[k:] - profile[:-k])) for k in shifts]
    k = shifts[int(np.argmin(differences))]
    drift = float(np.mean(profile[k:] - profile[:-k]))
    ahead = np.arange(n)
    return np.asarray(profile[len(profile) - k + ahead % k] + drift * (1 + ahead // k))


PREDICTORS: Mapping[str, Predictor] = {
    "plane": extend_plane,
    "quadratic": extend_quadratic,
    "period": extend_period,
}
"""Predictors by name, in order of preference among equally good ones."""


def _extend_polynomial(profile: FloatArray, n: int, degree: int) -> FloatArray:
    strip = profile[-round(STRIP_WIDTH / PROFILE_STEP) :]
    u = np.arange(len(strip)) * PROFILE_STEP
    fit = np.polynomial.Polynomial.fit(u, strip, degree)
    return np.asarray(fit((len(strip) + np.arange(n)) * PROFILE_STEP))


def _profile_frame(points: FloatArray) -> Pose2:
    """Return the frame of the profile: origin at the first point, x towards the last one."""
    way = points[-1] - points[0]
    return Pose2(float(points[0, 0]), float(points[0, 1]), float(np.arctan2(way[1], way[0])))


def _resample(local: FloatArray) -> FloatArray:
    """Return the depth (n,) every ``PROFILE_STEP`` along x; a mean where the profile turns back."""
    order = np.argsort(local[:, 0], kind="stable")
    u, index = np.unique(local[order, 0], return_inverse=True)
    v = np.bincount(index, local[order, 1]) / np.bincount(index)
    return np.asarray(np.interp(np.arange(0.0, u[-1] + PROFILE_STEP / 2, PROFILE_STEP), u, v))
