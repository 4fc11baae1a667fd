"""Range images of a tilted axis on an upright grid: lines of one azimuth, beams of one elevation.

Registration, target extraction, costmap and planners take the lines of a sweep as vertical and its
elevations as angles to the horizontal. A lidar that is pitched or rolled, or is mounted on its
side, has other lines. Its readings are placed on a grid about the vertical axis of ``scan``: with
the grid's centre c at the mean height of the lidar on that axis, the point P is at

    v = P - c,   yaw = atan2(v_y, v_x),   elevation = atan2(v_z, |v_x, v_y|),   r = |v|.

Each reading keeps its exact yaw and elevation, so that its point does not move. Of several in a
cell the one nearest to its middle is kept, a distance before none; the poles of a pattern, where
lines meet, are thinned thereby. Cells without a reading are ``UNMEASURED``.

Noise is that of the lines that were measured, estimated before: readings that follow each other on
a line of a URG-04LX share a running median, and lie across the lines of the grid, where they would
pass for independent ones with half the noise.

The rays of the grid start at c, those of the lidar up to its lever arm beside it: a range error is
taken as along the former, which at 1 m is 3 deg off for a lever of 0.05 m.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.registration.surfels.scan_noise import estimate_noise
from scan3d_twin.core.scanning.patterns import MAX_LEAN
from scan3d_twin.core.types import UNMEASURED, VALID, FloatArray, IntArray, RangeImage, read_only

CENTRAL = math.radians(40.0)
"""Largest elevation of the readings by which the spacing of the grid is chosen [rad]."""
SPACING_QUANTILE = 0.8
"""Share of neighbouring readings that are nearer to each other than the spacing of the grid."""
MIN_SPACING = math.radians(0.1)
"""Smallest spacing of the grid [rad]; no lidar of ours is finer."""


def is_upright(image: RangeImage) -> bool:
    """Return whether lines of ``image`` are vertical, but for the error of a mount."""
    T = image.T_scan_axis
    if T is not None and not np.array_equal(T, np.eye(4)):
        return False
    ahead, up = image.T_base_lidar[0, 0], image.T_base_lidar[2, 2]
    return bool(min(ahead, up) > math.cos(MAX_LEAN))


def make_upright(image: RangeImage) -> RangeImage:
    """Return ``image`` on an upright grid; as it is if it is one."""
    if is_upright(image):
        return image

    # Place the readings in azimuth and elevation
    reach = np.where(np.isfinite(image.ranges), image.ranges, image.spec.max_range)
    points = replace(image, ranges=reach).points
    heights = points[..., 2] - reach * image.directions[..., 2]
    centre = float(np.mean(heights))
    points[..., 2] -= centre
    yaws = np.arctan2(points[..., 1], points[..., 0])
    elevations = np.arctan2(points[..., 2], np.hypot(points[..., 0], points[..., 1]))
    distances = np.linalg.norm(points, axis=2)

    # Lay the grid
    measured = image.codes != UNMEASURED
    step_yaw, step_elevation = _choose_spacing(yaws, elevations, measured)
    half = float(np.max(np.abs(yaws), where=measured, initial=step_yaw))
    n = 2 * math.ceil(half / step_yaw) + 1
    n_beams = 2 * math.ceil(math.pi / 2 / step_elevation) + 1
    lines = np.clip(np.rint(n // 2 - yaws / step_yaw), 0, n - 1).astype(np.int64)
    beams = np.rint(n_beams // 2 + elevations / step_elevation).astype(np.int64)

    # Choose the reading of each cell
    off = np.hypot(
        (n // 2 - lines) * step_yaw - yaws, (beams - n_beams // 2) * step_elevation - elevations
    )
    cells = lines * n_beams + beams
    source, cell = _choose_readings(cells, off + np.where(np.isfinite(image.ranges), 0.0, 9.0),
                                    np.flatnonzero(measured))  # fmt: skip

    # Fill the grid
    grid_yaws = np.repeat(((n // 2 - np.arange(n)) * step_yaw)[:, None], n_beams, axis=1)
    nominal = (np.arange(n_beams) - n_beams // 2) * step_elevation
    grid_elevations = np.repeat(nominal[None], n, axis=0)
    ranges = np.full((n, n_beams), np.nan)
    codes = np.full((n, n_beams), UNMEASURED, dtype=np.int64)
    seen = np.where(np.isfinite(image.ranges), distances, np.nan)
    for grid, values in (
        (grid_yaws, yaws), (grid_elevations, elevations), (ranges, seen), (codes, image.codes),
    ):  # fmt: skip
        grid.flat[cell] = values.ravel()[source]
    stamps = _choose_stamps(image, n)
    T_base_lidar = np.eye(4)
    T_base_lidar[2, 3] = centre
    return RangeImage(
        stamps=read_only(stamps),
        yaws=read_only(grid_yaws),
        ranges=read_only(ranges),
        codes=read_only(codes, np.int64),
        spec=replace(
            image.spec,
            elevations=read_only(nominal),
            beam_times=read_only(np.zeros(n_beams)),
            line_period=float(stamps[-1] - stamps[0]) / max(1, n - 1),
        ),
        T_base_lidar=read_only(T_base_lidar),
        elevations=read_only(grid_elevations),
        T_scan_axis=read_only(np.eye(4)),
        noise=_estimate_range_noise(image),
    )


def _estimate_range_noise(image: RangeImage) -> FloatArray:
    """Return the noise of the readings on their own lines (4,): see ``RangeImage.noise``.

    The yaw jitter of the grid's lines is left to be estimated on the grid.
    """
    found = estimate_noise(image, (image.codes == VALID) & np.isfinite(image.ranges))
    sigma, growth, _, correlation = found.values.tolist()
    return read_only([sigma, growth, math.nan, correlation])


def _choose_stamps(image: RangeImage, n: int) -> FloatArray:
    """Return the stamps of ``n`` lines [s].

    A line of the grid was measured at many times. By a turntable, they are spread over the time of
    the sweep. Where the base turned, all are of the moment at which it stood as the frame ``scan``
    does, for its pose then is that of the frame.
    """
    if image.T_scan_axis is not None:
        return np.linspace(image.stamps.min(), image.stamps.max(), n)
    middle = image.spec.n_beams // 2
    order = np.argsort(image.yaws[:, middle], kind="stable")
    times = image.stamps[order] + image.spec.beam_times[middle]
    return np.full(n, np.interp(0.0, image.yaws[order, middle], times))


def _choose_spacing(
    yaws: FloatArray, elevations: FloatArray, measured: np.ndarray
) -> tuple[float, float]:
    """Return the spacing of the grid in yaw and in elevation [rad].

    It is that of neighbouring readings near the horizon, along lines or across, whichever is wider.
    """
    central = measured & (np.abs(elevations) < CENTRAL)
    spacings = []
    for angles in (yaws, elevations):
        steps = []
        for axis in (0, 1):
            pair = central & np.roll(central, -1, axis)
            change = np.abs(np.roll(angles, -1, axis) - angles)
            change = np.minimum(change, math.tau - change)
            last = np.s_[:-1] if axis == 0 else np.s_[:, :-1]
            near = change[last][pair[last]]
            steps.append(float(np.quantile(near, SPACING_QUANTILE)) if len(near) else 0.0)
        spacings.append(max(MIN_SPACING, *steps))
    return spacings[0], spacings[1]


def _choose_readings(
    cells: IntArray, cost: FloatArray, wanted: IntArray
) -> tuple[IntArray, IntArray]:
    """Return the flat indices of the readings that are kept, and the cell of each.

    Args:
        cells: Flat index of each reading's cell (n_lines, n_beams).
        cost: The reading with the least of it is kept (n_lines, n_beams).
        wanted: Flat indices of the readings that may be kept.
    """
    own, price = cells.ravel()[wanted], cost.ravel()[wanted]
    order = np.lexsort((price, own))
    first = np.ones(len(order), dtype=bool)
    first[1:] = own[order][1:] != own[order][:-1]
    kept = wanted[order[first]]
    return kept, cells.ravel()[kept]
