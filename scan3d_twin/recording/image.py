"""One 3D image as a file: the raw range image of a sweep."""

from __future__ import annotations

import io

import numpy as np

from scan3d_twin.core.types import Observation


def image_bytes(observation: Observation) -> bytes:
    """Return a sweep as a compressed .npz; equal sweeps give equal bytes.

    Its arrays, by the names and with the units of ``RangeImage`` and ``LidarSpec``: ``stamps, yaws,
    ranges, codes, elevations, beam_times, T_base_lidar``, and ``points`` (n_lines, n_beams, 3) in
    frame ``scan`` with NaN where there is no return.
    """
    image = observation.image
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        stamps=image.stamps,
        yaws=image.yaws,
        ranges=image.ranges,
        codes=image.codes.astype(np.int16),
        elevations=image.spec.elevations,
        beam_times=image.spec.beam_times,
        T_base_lidar=image.T_base_lidar,
        points=image.points,
    )
    return buffer.getvalue()
