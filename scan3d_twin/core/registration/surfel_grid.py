"""A sweep made ready for registration: its surfels, its edges and its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration.compiled import compiled
from scan3d_twin.core.registration.edges import Edges, find_edges
from scan3d_twin.core.registration.median import median
from scan3d_twin.core.registration.projection import Projection
from scan3d_twin.core.registration.scan_noise import (
    BIAS_PATCH,
    ScanNoise,
    estimate_range_noise,
    line_residuals,
    yaw_jitter,
)
from scan3d_twin.core.registration.surfels import VARIANCE, fit_surfels, knowledge
from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray, RangeImage, Scan3D

WINDOWS = tuple(math.radians(angle) for angle in (2.1, 1.45, 0.85, 0.0))
"""Half sizes of the windows along lines and beams [rad]; at least one reading to each side."""
MIN_SURFELS = 50
"""Fewer surfels than this determine nothing reliably."""


@dataclass(frozen=True)
class SurfelGrid:
    """Surfels of a sweep in frame ``scan``, on the grid of its lines and beams.

    Attributes:
        image: What they were made from.
        noise: What the sweep's readings were taken to err by.
        table: (n_lines, n_beams, 8), columns as above; the variance is 0 where there is no surfel.
        valid: Readings that are distances (n_lines, n_beams).
    """

    image: RangeImage
    noise: ScanNoise
    table: FloatArray
    valid: BoolArray

    @cached_property
    def projection(self) -> Projection:
        """The way from a point to the line and beam that see it."""
        return Projection.of(self.image)

    @cached_property
    def edges(self) -> Edges:
        """Vertical edges at which surfaces end in view."""
        return find_edges(self.image, self.table, self.valid, self.noise.yaw_sigma)

    @cached_property
    def known(self) -> IntArray:
        """What each reading says of its ray (n_lines * n_beams,): see ``free_space``."""
        return knowledge(self.table, self.valid)

    @cached_property
    def line_spacing(self) -> float:
        """Typical angle between two lines [rad]."""
        return _line_spacing(self.image)

    @cached_property
    def inflation(self) -> float:
        """Factor on the variance of a reading for what it shares with its neighbours."""
        beam_spacing = median(np.abs(np.diff(self.image.spec.elevations)))
        return self.noise.inflation(BIAS_PATCH**2 / (self.line_spacing * beam_spacing))

    @cached_property
    def middle_yaw(self) -> float:
        """Yaw of the middle of the sweep, about which an error of the yaw scale turns [rad]."""
        return float(np.mean(self.image.yaws[:, self.image.spec.n_beams // 2]))

    def sample(self, stride: int) -> Sample:
        """Return every ``stride``-th surfel along lines and beams."""
        if stride not in self._samples:
            self._samples[stride] = self._sample(stride)
        return self._samples[stride]

    @cached_property
    def _samples(self) -> dict[int, Sample]:
        return {}

    def _sample(self, stride: int) -> Sample:
        first = stride // 2
        rows = self.table[first::stride, first::stride]
        line, beam = np.nonzero(rows[..., VARIANCE] > 0)
        yaws = self.image.yaws[first::stride, first::stride][line, beam] - self.middle_yaw
        return Sample(
            np.ascontiguousarray(rows[line, beam]),
            np.ascontiguousarray(yaws),
            line * stride + first,
            stride,
        )

    @cached_property
    def count(self) -> int:
        """Number of surfels."""
        return int(np.count_nonzero(self.table[..., VARIANCE]))


@dataclass(frozen=True)
class Sample:
    """Surfels taken from a grid.

    Attributes:
        rows: (m, 8), columns as in ``SurfelGrid.table``, sorted by line.
        yaws: At which each was measured, from the middle of the sweep (m,) [rad].
        lines: Line of each (m,), ascending.
        stride: Each stands for ``stride`` squared readings.
    """

    rows: FloatArray
    yaws: FloatArray
    lines: IntArray
    stride: int


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
    with np.errstate(invalid="ignore"):
        valid = (image.codes == VALID) & (image.ranges > 0) & np.isfinite(image.ranges)
    mask = _mask(keep, valid)
    if noise is None:
        noise = _estimated_range_noise(image, valid)
        table = _fit(image, valid, mask, noise)
        noise = replace(noise, yaw_sigma=_estimated_jitter(image, table))
    else:
        table = _fit(image, valid, mask, noise)
    grid = SurfelGrid(image, noise, table, valid)
    if grid.count < MIN_SURFELS:
        raise RegistrationError(
            f"the scan shows too little surface: {int(mask.sum())} readings of {image.ranges.size} "
            f"gave {grid.count} surfels, {MIN_SURFELS} are needed"
        )
    return grid


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
    if not (np.all(np.isfinite(image.yaws)) and np.all(np.isfinite(image.T_base_lidar))):
        raise ConfigError("range image: yaws and T_base_lidar must be finite")
    if not np.all(np.isfinite(image.spec.elevations)):
        raise ConfigError("range image: elevations must be finite")


def _mask(keep: BoolArray | Scan3D | None, valid: BoolArray) -> BoolArray:
    if keep is None:
        return valid
    if isinstance(keep, Scan3D):
        mask = np.zeros(valid.shape, dtype=bool)
        mask[keep.lines, keep.beams] = True
        return mask & valid
    if keep.shape != valid.shape:
        raise ConfigError(f"keep has shape {keep.shape}, the range image {valid.shape}")
    return np.asarray(keep & valid)


def _fit(image: RangeImage, valid: BoolArray, keep: BoolArray, noise: ScanNoise) -> FloatArray:
    """Return the table of surfels; only the part of the grid that holds readings costs time."""
    part = (_used(np.any(valid, axis=1)), _used(np.any(valid, axis=0)))
    ranges, yaws, beams, lever = _frame(image)
    run = compiled("fit_surfels") or fit_surfels
    found: FloatArray = run(
        ranges[part], yaws[part], beams[part[1]], lever, valid[part], keep[part],
        np.array([noise.range_sigma, noise.range_sigma_per_metre]), _half_sizes(image),
    )  # fmt: skip
    if found.shape[:2] == valid.shape:
        return found
    table = np.zeros((*valid.shape, 8))
    table[part] = found
    return table


def _used(any_valid: npt.ArrayLike) -> slice:
    """Return the slice from the first to the last True; one entry if there is none."""
    used = np.flatnonzero(any_valid)
    return slice(used[0], used[-1] + 1) if len(used) else slice(0, 1)


def _estimated_range_noise(image: RangeImage, valid: BoolArray) -> ScanNoise:
    estimated = estimate_range_noise(image, valid)
    if estimated is None:
        return ScanNoise()
    return replace(ScanNoise(), range_sigma=estimated[0], range_sigma_per_metre=estimated[1])


def _estimated_jitter(image: RangeImage, table: FloatArray) -> float:
    run = compiled("line_residuals") or line_residuals
    return yaw_jitter(run(image.ranges, image.yaws, image.T_base_lidar[:3, 3].copy(), table))


def _frame(image: RangeImage) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return ranges and yaws (n_lines, n_beams), the beams in ``base`` (n_beams, 3), the lever."""
    e, R = image.spec.elevations, image.T_base_lidar[:3, :3]
    beams = np.cos(e)[:, None] * R[:, 0] + np.sin(e)[:, None] * R[:, 2]
    return image.ranges, image.yaws, beams, np.ascontiguousarray(image.T_base_lidar[:3, 3])


def _half_sizes(image: RangeImage) -> IntArray:
    """Return the half sizes of the windows in lines and beams (4, 2), largest first."""
    steps = np.array([_line_spacing(image), median(np.abs(np.diff(image.spec.elevations)))])
    halves = np.round(np.array(WINDOWS)[:, None] / np.maximum(steps, 1e-4))
    sizes: IntArray = np.clip(halves, 1, 12).astype(np.int64)
    return sizes


def _line_spacing(image: RangeImage) -> float:
    return median(np.abs(np.diff(image.yaws[:, image.spec.n_beams // 2])))
