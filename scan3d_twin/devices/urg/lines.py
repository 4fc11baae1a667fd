"""From SCIP steps and millimetres to the scan lines of the hardware interface."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import (
    LOST,
    UNMEASURED,
    VALID,
    IntArray,
    LidarSpec,
    ScanLine,
    read_only,
)
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg import salvage
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.model import DETECTED_RANGE_MM, LINKS, step_angle, step_time
from scan3d_twin.devices.urg.scan_modes import period


def link_spec(link: str) -> LidarSpec:
    """Return the geometry of the lines that come over the named ``link``."""
    mode = LINKS[link]
    return LidarSpec(
        elevations=read_only([step_angle(step) for step in mode.steps]),
        beam_times=read_only([step_time(step) for step in mode.steps]),
        line_period=mode.line_period,
        min_range=urg04lx.MIN_RANGE_MM / 1000,
        max_range=urg04lx.MAX_RANGE_MM / 1000,
    )


def line_spec(request: ScanRequest) -> LidarSpec:
    """Return the geometry of the lines of a stream; a cluster is represented by its middle."""
    steps = range(request.first, request.last + 1)
    groups = [steps[i : i + request.cluster] for i in range(0, len(steps), request.cluster)]
    return LidarSpec(
        elevations=read_only([(step_angle(g[0]) + step_angle(g[-1])) / 2 for g in groups]),
        beam_times=read_only([(step_time(g[0]) + step_time(g[-1])) / 2 for g in groups]),
        line_period=period(request),
        min_range=urg04lx.MIN_RANGE_MM / 1000,
        max_range=urg04lx.MAX_RANGE_MM / 1000,
    )


def to_line(stamp: float, values: IntArray, detected_range_mm: int = DETECTED_RANGE_MM) -> ScanLine:
    """Return a scan line from the readings.

    A reading beyond the data sheet's range is dropped, as the two-character encoding does. One that
    the sensor cannot have measured says nothing.

    Args:
        stamp: Time of step 0 [s].
        values: Distances [mm], error codes or ``salvage.LOST``, (n_beams,).
        detected_range_mm: Longest distance that the sensor sends [mm].
    """
    near, far = values < urg04lx.MIN_RANGE_MM, values > urg04lx.MAX_RANGE_MM
    ranges = np.where(near | far, np.nan, values / 1000)
    codes = np.where(near, values, np.where(far, urg04lx.NO_RETURN, VALID))
    codes = np.where(values > detected_range_mm, UNMEASURED, codes)
    codes = np.where(values == salvage.LOST, LOST, codes)
    return ScanLine(stamp, read_only(ranges), read_only(codes, np.int64))
