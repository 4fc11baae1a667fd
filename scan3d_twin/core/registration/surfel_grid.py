"""A sweep made ready for registration: its surfels, its edges and its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.edges import Edges, find_edges
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.scan_noise import BIAS_PATCH, ScanNoise
from scan3d_twin.core.registration.surfels import Beams, known_rays, sweep_of
from scan3d_twin.core.types import (
    VALID,
    BoolArray,
    FloatArray,
    RangeImage,
    Scan3D,
    SmallIntArray,
    read_only,
)

MIN_SURFELS = 50
"""Fewer surfels than this determine nothing reliably."""
LEAST_SAMPLE = 200
"""Surfels that a thinned sample keeps at least, where there are as many."""


@dataclass(frozen=True)
class Sample:
    """Surfels taken from a sweep, sorted by line.

    Attributes:
        columns: (8, m), as in ``surfels``.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        lines: Line of each (m,), ascending.
        stride: Each stands for ``stride`` squared readings.
        value: The sample as the engine takes it.
    """

    columns: FloatArray
    yaws: FloatArray
    lines: SmallIntArray
    stride: int
    value: native.Sample

    @property
    def rows(self) -> FloatArray:
        """The surfels (m, 8)."""
        return self.columns.T

    def __len__(self) -> int:
        return len(self.yaws)


@dataclass(frozen=True)
class SurfelGrid:
    """Surfels of a sweep in frame ``scan``, on the grid of its lines and beams.

    Attributes:
        image: What they were made from.
        noise: What the sweep's readings were taken to err by.
        rows: Surfels (m, 8), columns as in ``surfels``, line by line.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        index: Row of each reading (n_lines, n_beams), -1 where there is no surfel.
        valid: Readings that are distances (n_lines, n_beams).
        line_spacing: Typical angle between two lines [rad].
    """

    image: RangeImage
    noise: ScanNoise
    rows: FloatArray
    yaws: FloatArray
    index: SmallIntArray
    valid: BoolArray
    line_spacing: float

    def at(self, part: tuple[slice, slice]) -> FloatArray:
        """Return the surfels of a part of the grid (n, m, 8), 0 where there is none."""
        index = self.index[part]
        return np.where(index[..., None] >= 0, self.rows[index], 0.0)

    @cached_property
    def projection(self) -> Projection:
        """The way from a point to the line and beam that see it."""
        return Projection.of(self.image, self.line_spacing)

    @cached_property
    def target(self) -> native.Target:
        """What other scans are laid on, as the engine takes it."""
        return native.Target(
            rows=self.rows,
            yaws=self.yaws,
            index=self.index,
            edges=self.edge_rows,
            n_edges=len(self.edge_rows),
            projection=self.projection.value,
        )

    @cached_property
    def edges(self) -> Edges:
        """Vertical edges at which surfaces end in view."""
        return Edges.of(self.edge_rows)

    @cached_property
    def edge_rows(self) -> FloatArray:
        """The same as rows (n, 8), see ``edges``."""
        return find_edges(self.image, self.rows, self.index, self.valid, self.noise.yaw_sigma)

    @cached_property
    def known(self) -> native.ByteArray:
        """What each reading knows of its ray (n_lines * n_beams,): see ``known_rays``."""
        return known_rays(self.index, self.valid)

    @cached_property
    def inflation(self) -> float:
        """Factor on the variance of a reading for what it shares with its neighbours."""
        return self.noise.inflation(
            BIAS_PATCH**2 / (self.line_spacing * Beams.of(self.image).spacing)
        )

    def sample(self, stride: int) -> Sample:
        """Return every ``stride``-th surfel along lines and beams.

        The first is half a stride from the corner. Where it would leave fewer than
        ``LEAST_SAMPLE``, the stride is as long as leaves about so many: a small target keeps
        enough of its surfels.
        """
        stride = max(1, min(stride, math.isqrt(self.count // LEAST_SAMPLE)))
        if stride not in self._samples:
            self._samples[stride] = self._sample(stride)
        return self._samples[stride]

    @cached_property
    def _samples(self) -> dict[int, Sample]:
        return {}

    def _sample(self, stride: int) -> Sample:
        n_lines, n_beams = self.index.shape
        room = min(self.count, (n_lines // stride + 1) * (n_beams // stride + 1))
        columns, yaws, lines = np.empty((8, room)), np.empty(room), np.empty(room, np.int32)
        value = native.Sample(stride=stride, room=room, columns=columns, yaws=yaws, lines=lines)
        engine.sample(self.index, n_lines, n_beams, self.rows, self.yaws, value)
        n = value.count
        return Sample(columns[:, :n], yaws[:n], lines[:n], stride, value)

    @property
    def count(self) -> int:
        """Number of surfels."""
        return len(self.rows)


def prepare(
    image: RangeImage, *, keep: BoolArray | Scan3D | None = None, noise: ScanNoise | None = None
) -> SurfelGrid:
    """Return the surfels of ``image``; they can serve for any number of registrations.

    Args:
        image: A sweep; filled gaps are no readings.
        keep: Readings (n_lines, n_beams), or their points, that get a surfel; all by default.
        noise: Of the sweep; by default range noise and yaw jitter are estimated from it.

    Raises:
        RegistrationError: The sweep is empty or shows no surface.
        ConfigError: The image's parts do not fit together or its yaws are not finite.
    """
    _check(image)
    mask = _mask(keep, image.codes.shape)
    grid = _survey(image, mask, noise)
    if grid.count < MIN_SURFELS:
        wanted = grid.valid if mask is None else grid.valid & mask
        raise RegistrationError(
            f"the scan shows too little surface: {np.count_nonzero(wanted)} readings "
            f"of {image.ranges.size} gave {grid.count} surfels, {MIN_SURFELS} are needed"
        )
    return grid


def _survey(image: RangeImage, mask: BoolArray | None, noise: ScanNoise | None) -> SurfelGrid:
    """Return what ``native/survey.h`` finds in a sweep."""
    most = np.count_nonzero(image.codes == VALID if mask is None else mask)
    rows, yaws = np.empty((most, 8)), np.empty(most)
    index, valid = np.empty(image.ranges.shape, np.int32), np.empty(image.ranges.shape, np.bool_)
    sigmas = UNKNOWN if noise is None else noise.sigmas
    found = native.Survey(rows=rows, yaws=yaws, index=index, valid=valid, noise=sigmas)
    if engine.survey(sweep_of(image), read_only(image.codes, np.int64), mask, found) < 0:
        raise MemoryError
    noise = noise or ScanNoise(*found.noise)
    n = found.count
    return SurfelGrid(image, noise, rows[:n], yaws[:n], index, valid, found.line_spacing)


UNKNOWN = read_only([math.nan] * 3)
"""The noise is to be estimated."""


def _check(image: RangeImage) -> None:
    shape = (image.n_lines, image.spec.n_beams)
    for name in ("yaws", "ranges", "codes"):
        if getattr(image, name).shape != shape:
            raise ConfigError(
                f"range image: {name} has shape {getattr(image, name).shape}, but {shape[0]} lines "
                f"of {shape[1]} beams were announced"
            )
    if min(shape) < 5:
        raise RegistrationError(f"a scan of {shape[0]} lines and {shape[1]} beams is too small")
    if not math.isfinite(np.sum(image.yaws)):
        raise ConfigError("range image: yaws must be finite")


def _mask(keep: BoolArray | Scan3D | None, shape: tuple[int, ...]) -> BoolArray | None:
    if keep is None:
        return None
    if isinstance(keep, Scan3D):
        mask = np.zeros(shape, dtype=bool)
        mask[keep.lines, keep.beams] = True
    elif keep.shape != shape:
        raise ConfigError(f"keep has shape {keep.shape}, the range image {shape}")
    else:
        mask = keep
    return read_only(mask, np.bool_)
