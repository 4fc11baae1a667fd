"""Gap filling (paper section 4.1): linear interpolation across missing readings."""

from __future__ import annotations

from dataclasses import replace

from scan3d_twin.core.config import GapConfig
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.types import RangeImage, read_only


def fill_gaps(image: RangeImage, config: GapConfig) -> RangeImage:
    """Return ``image`` with narrow gaps filled, first along each line, then across lines.

    A gap is filled when it is narrower than ``config.max_angle`` and the readings on its two sides
    differ by less than ``config.depth_edge``, so never across a depth edge. Measured readings are
    kept as they are; filled ones keep their error code. ``native/readings.h`` fills them.
    """
    ranges, elevations = image.ranges.copy(), read_only(image.elevation_rows)
    engine.fill_gaps(
        ranges, elevations, len(elevations) > 1, read_only(image.yaws), *ranges.shape,
        config.max_angle, config.depth_edge,
    )  # fmt: skip
    ranges.flags.writeable = False
    return replace(image, ranges=ranges)
