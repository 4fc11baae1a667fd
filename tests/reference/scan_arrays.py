"""Sweeps and surfels as tuples of arrays, the arguments of the reference functions."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from reference.projection import Projection
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import FloatArray, RangeImage, SmallIntArray, read_only


class Beams(NamedTuple):
    """The beams of a lidar on its mount.

    Attributes:
        directions: In ``base`` (n_beams, 3).
        lever: Place of the lidar in ``base`` (3,) [m].
        spacing: Typical angle between two beams [rad].
    """

    directions: FloatArray
    lever: FloatArray
    spacing: float

    @staticmethod
    def of(image: RangeImage) -> Beams:
        """Return the beams of a sweep; they are the same in all sweeps of a lidar.

        Raises:
            ConfigError: Elevations or mount are not finite.
        """
        return _beams(read_only(image.spec.elevations).tobytes(), image.T_base_lidar.tobytes())


@lru_cache(maxsize=16)
def _beams(elevations: bytes, T_base_lidar: bytes) -> Beams:
    e, T = np.frombuffer(elevations), np.frombuffer(T_base_lidar).reshape(4, 4)
    if not (np.all(np.isfinite(e)) and np.all(np.isfinite(T))):
        raise ConfigError("range image: elevations and T_base_lidar must be finite")
    directions = np.cos(e)[:, None] * T[:3, 0] + np.sin(e)[:, None] * T[:3, 2]
    return Beams(read_only(directions), read_only(T[:3, 3]), float(np.median(np.abs(np.diff(e)))))


class Target(NamedTuple):
    """The surfels of a sweep, found by the ray that sees a point.

    Attributes:
        rows: (m, 8), columns as in ``surfels``.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        row_of: Row of each reading (n_lines * n_beams,), or -1.
        projection: From a point to the reading that sees it.
    """

    rows: FloatArray
    yaws: FloatArray
    row_of: SmallIntArray
    projection: Projection


class Sample(NamedTuple):
    """Surfels taken from a sweep.

    Attributes:
        rows: (m, 8), columns as in ``surfels``, sorted by line.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        lines: Line of each (m,), ascending.
        stride: Each stands for ``stride`` squared readings.
    """

    rows: FloatArray
    yaws: FloatArray
    lines: SmallIntArray
    stride: int


def sampled(
    rows: FloatArray, yaws: FloatArray, index: SmallIntArray, stride: int
) -> tuple[FloatArray, FloatArray, SmallIntArray]:
    """Return every ``stride``-th surfel along lines and beams: rows, yaws and lines.

    Args:
        rows: All of them (m, 8).
        yaws: At which each was measured (m,) [rad].
        index: Row of each reading (n_lines, n_beams), or -1.
        stride: The first is half of it from the corner.
    """
    first = stride // 2
    part = index[first::stride, first::stride]
    line, beam = np.nonzero(part >= 0)
    lines = (line * stride + first).astype(np.int32)
    if stride == 1:
        return rows, yaws, lines
    chosen = part[line, beam]
    return rows[chosen], yaws[chosen], lines
