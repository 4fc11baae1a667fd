"""Checks of what was read from a file: shapes, kinds, order and finite numbers.

Each type of the core trusts its arrays; what comes from elsewhere is checked here, once.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray, LidarSpec, Pose2, RangeImage, Scan3D

MAX_LENGTH = 1e4
"""Largest distance or coordinate that is believed [m]: a hundred times the reach of any lidar."""
LEAST_NOISE = np.array([1e-6, 0.0, 0.0, 1.0])
"""Smallest numbers of a sweep's noise: some of it, and a mean that is no better than of independent
readings."""
MAX_NUMBER = 1e9
"""Largest number of an array: a time of thirty years [s]."""


def check_session(session: Session) -> None:
    """Check the views, panoramas and plans of ``session``.

    Raises:
        FileError: One is not what its type promises; the message names it.
    """
    _require("hint", session.hint, (None, 2))
    _require("front", session.front, (2,))
    for k, view in enumerate(session.views):
        try:
            _check_view(view)
        except FileError as error:
            raise FileError(f"view {k}: {error}") from None
    for number, panorama in session.panoramas:
        check_image(panorama.image)
        _check_pose("a panorama", panorama.T_odom_scan)
        if number < 0:
            raise FileError(f"a panorama after {number} views")
    for plan in session.plans:
        for place in (plan.viewpoint, *(each.viewpoint for each in plan.candidates)):
            if place is not None:
                _check_pose("a plan", place)
    if any(not k >= 0 for k in session.misfits):
        raise FileError("misfits that are no views")


def check_track(track: FloatArray) -> None:
    """Check stamps and poses of the odometry (n, 4), see ``read_track``.

    Raises:
        FileError: One is no number that a robot has.
    """
    _require("odometry", track, (None, 4))


def _check_view(view: View) -> None:
    check_image(view.observation.image)
    check_image(view.image)
    _check_pose("its odometry", view.observation.T_odom_scan)
    _check_pose("its pose", view.T_world_scan)
    for name, scan in (("target", view.target), ("sweep", view.sweep)):
        _check_scan(name, scan, view.image.ranges.shape)
    result = view.registration
    if result is not None:
        _require("T_target_source", result.T_target_source, (4, 4))
        if np.shape(result.covariance) != (6, 6):  # what is undetermined varies infinitely
            raise FileError(f"covariance: {np.shape(result.covariance)} does not fit")


def check_image(image: RangeImage) -> None:
    """Check the arrays of a range image.

    Raises:
        FileError: One has another shape or kind, or holds what no measurement is.
    """
    # Shapes
    _check_spec(image.spec)
    lines, beams = len(image.stamps), image.spec.n_beams
    if lines == 0 or beams == 0:
        raise FileError("a sweep without readings")
    _require("stamps", image.stamps, (None,))
    _require("T_base_lidar", image.T_base_lidar, (4, 4))
    if image.T_scan_axis is not None:
        _require("T_scan_axis", image.T_scan_axis, (4, 4))
    if image.noise is not None:
        _require("noise", image.noise, (4,), nan=True)
    _require("yaws", image.yaws, (lines, beams))
    _require("codes", image.codes, (lines, beams), kinds="iu")
    _require("ranges", image.ranges, (lines, beams), nan=True)
    if image.elevations is not None:
        _require("elevations of the lines", image.elevations, (lines, beams))

    # Values
    if np.nanmin(image.ranges, initial=0.0) < 0:
        raise FileError("ranges below 0")
    if image.noise is not None and np.any(image.noise < LEAST_NOISE):
        raise FileError("noise that is none")
    for name, T in (("T_base_lidar", image.T_base_lidar), ("T_scan_axis", image.T_scan_axis)):
        if T is not None and not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6):
            raise FileError(f"{name} is no transform")


def _check_spec(spec: LidarSpec) -> None:
    _require("elevations", spec.elevations, (None,))
    _require("beam_times", spec.beam_times, (len(spec.elevations),))
    limits = (spec.line_period, spec.min_range, spec.max_range)
    if not all(math.isfinite(each) and each >= 0 for each in limits) or spec.max_range <= 0:
        raise FileError(f"a lidar of {limits} s, m, m")


def _check_scan(name: str, scan: Scan3D, shape: tuple[int, ...]) -> None:
    """Check a scan whose range image has ``shape``."""
    count = len(scan.points)
    _require(f"points of the {name}", scan.points, (count, 3))
    for what, indices, limit in (("lines", scan.lines, shape[0]), ("beams", scan.beams, shape[1])):
        _require(f"{what} of the {name}", indices, (count,), kinds="iu")
        if count and not (int(indices.min()) >= 0 and int(indices.max()) < limit):
            raise FileError(f"{what} of the {name} out of range")
    if scan.n_lines != shape[0] or (count and np.any(np.diff(scan.lines) < 0)):
        raise FileError(f"lines of the {name} out of order")


def _check_pose(name: str, pose: Pose2) -> None:
    if not (abs(pose.x) <= MAX_LENGTH and abs(pose.y) <= MAX_LENGTH and math.isfinite(pose.yaw)):
        raise FileError(f"{name} is at {pose.x:g}, {pose.y:g} m")


def _require(
    name: str, array: Any, shape: tuple[int | None, ...], *, kinds: str = "f", nan: bool = False
) -> None:
    """Check kind, shape and numbers of ``array``; None fits any length, NaN passes if ``nan``."""
    array = np.asarray(array)
    fits = len(array.shape) == len(shape) and all(
        wanted in (None, actual) for actual, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds:
        raise FileError(f"{name}: {array.dtype} {array.shape} does not fit")
    if kinds != "f":
        return
    bad = np.isinf(array) if nan else ~np.isfinite(array)
    if bad.any() or (array.size and np.nanmax(np.abs(array), initial=0.0) > MAX_NUMBER):
        raise FileError(f"{name}: numbers that are no measurements")
