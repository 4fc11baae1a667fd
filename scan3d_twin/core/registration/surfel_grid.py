"""A sweep made ready for registration: its surfels, its edges and its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.compiled import compiled
from scan3d_twin.core.registration.edges import Edges, find_edges
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.scan_arrays import Beams, Sample, Target, sampled
from scan3d_twin.core.registration.scan_noise import BIAS_PATCH, ScanNoise
from scan3d_twin.core.registration.surfels import knowledge
from scan3d_twin.core.registration.survey import Swept, survey
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    RangeImage,
    Scan3D,
    SmallIntArray,
    read_only,
)

MIN_SURFELS = 50
"""Fewer surfels than this determine nothing reliably."""


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
    def target(self) -> Target:
        """What other scans are laid on."""
        return Target(self.rows, self.yaws, self.index.reshape(-1), self.projection)

    @cached_property
    def edges(self) -> Edges:
        """Vertical edges at which surfaces end in view."""
        return Edges.of(self.edge_rows)

    @cached_property
    def edge_rows(self) -> FloatArray:
        """The same as rows (n, 8), see ``edges``."""
        return find_edges(self.image, self.rows, self.index, self.valid, self.noise.yaw_sigma)

    @cached_property
    def known(self) -> SmallIntArray:
        """What each reading says of its ray (n_lines * n_beams,): see ``free_space``."""
        return knowledge(self.index, self.valid)

    @cached_property
    def inflation(self) -> float:
        """Factor on the variance of a reading for what it shares with its neighbours."""
        return self.noise.inflation(
            BIAS_PATCH**2 / (self.line_spacing * Beams.of(self.image).spacing)
        )

    def sample(self, stride: int) -> Sample:
        """Return every ``stride``-th surfel along lines and beams."""
        if stride not in self._samples:
            self._samples[stride] = self._sample(stride)
        return self._samples[stride]

    @cached_property
    def _samples(self) -> dict[int, Sample]:
        return {}

    def _sample(self, stride: int) -> Sample:
        run = compiled("sampled") or sampled
        rows, yaws, lines = run(self.rows, self.yaws, self.index, stride)
        return Sample(rows, yaws, lines, stride)

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
    sigmas = UNKNOWN if noise is None else noise.sigmas
    with np.errstate(invalid="ignore"):
        found = (compiled("survey") or survey)(_swept(image), mask, sigmas)
    if len(found.rows) < MIN_SURFELS:
        wanted = found.valid & mask if mask.size > 0 else found.valid
        raise RegistrationError(
            f"the scan shows too little surface: {np.count_nonzero(wanted)} readings "
            f"of {image.ranges.size} gave {len(found.rows)} surfels, {MIN_SURFELS} are needed"
        )
    sigma, per_metre, yaw_sigma = found.noise.tolist()
    noise = noise or ScanNoise(sigma, per_metre, yaw_sigma)
    return SurfelGrid(
        image, noise, found.rows, found.yaws, found.row_of, found.valid, found.line_spacing
    )


UNKNOWN = read_only([math.nan] * 3)
"""The noise is to be estimated."""
ALL = read_only(np.zeros((0, 0)), np.bool_)
"""All readings get a surfel."""


def _swept(image: RangeImage) -> Swept:
    codes = read_only(image.codes, np.int64)
    return Swept(read_only(image.ranges), read_only(image.yaws), codes, Beams.of(image))


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


def _mask(keep: BoolArray | Scan3D | None, shape: tuple[int, ...]) -> BoolArray:
    if keep is None:
        return ALL
    if isinstance(keep, Scan3D):
        mask = np.zeros(shape, dtype=bool)
        mask[keep.lines, keep.beams] = True
    elif keep.shape != shape:
        raise ConfigError(f"keep has shape {keep.shape}, the range image {shape}")
    else:
        mask = keep
    return read_only(mask, np.bool_)
