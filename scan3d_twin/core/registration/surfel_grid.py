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
from scan3d_twin.core.registration.scan_arrays import Sample, Target
from scan3d_twin.core.registration.scan_noise import (
    BIAS_PATCH,
    ScanNoise,
    estimate_range_noise,
    line_residuals,
    yaw_jitter,
)
from scan3d_twin.core.registration.surfels import fit_surfels, knowledge
from scan3d_twin.core.types import (
    VALID,
    BoolArray,
    FloatArray,
    IntArray,
    RangeImage,
    Scan3D,
    SmallIntArray,
)

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
        rows: Surfels (m, 8), columns as in ``surfels``, line by line.
        index: Row of each reading (n_lines, n_beams), -1 where there is no surfel.
        valid: Readings that are distances (n_lines, n_beams).
    """

    image: RangeImage
    noise: ScanNoise
    rows: FloatArray
    index: SmallIntArray
    valid: BoolArray

    def at(self, part: tuple[slice, slice]) -> FloatArray:
        """Return the surfels of a part of the grid (n, m, 8), 0 where there is none."""
        index = self.index[part]
        return np.where(index[..., None] >= 0, self.rows[index], 0.0)

    @cached_property
    def projection(self) -> Projection:
        """The way from a point to the line and beam that see it."""
        return Projection.of(self.image)

    @cached_property
    def target(self) -> Target:
        """What other scans are laid on."""
        return Target(self.rows, self.yaws, self.index.reshape(-1), self.projection)

    @cached_property
    def yaws(self) -> FloatArray:
        """At which each surfel was measured, from the middle of the sweep (m,) [rad]."""
        return self.image.yaws[self.index >= 0] - self.middle_yaw

    @cached_property
    def edges(self) -> Edges:
        """Vertical edges at which surfaces end in view."""
        return find_edges(self.image, self.rows, self.index, self.valid, self.noise.yaw_sigma)

    @cached_property
    def known(self) -> SmallIntArray:
        """What each reading says of its ray (n_lines * n_beams,): see ``free_space``."""
        return knowledge(self.index, self.valid)

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
        index = self.index[first::stride, first::stride]
        line, beam = np.nonzero(index >= 0)
        if stride == 1:
            return Sample(self.rows, self.yaws, np.ascontiguousarray(line), stride)
        chosen = index[line, beam]
        return Sample(self.rows[chosen], self.yaws[chosen], line * stride + first, stride)

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
    with np.errstate(invalid="ignore"):
        valid = (image.codes == VALID) & (image.ranges > 0) & np.isfinite(image.ranges)
    mask, used = _mask(keep, valid), Used.of(image, valid)
    if noise is None:
        noise = used.range_noise()
        rows, part = used.fit(mask, noise)
        noise = replace(noise, yaw_sigma=used.yaw_jitter(rows, part))
    else:
        rows, part = used.fit(mask, noise)
    index = np.full(valid.shape, -1, dtype=np.int32)
    index[used.part] = part
    grid = SurfelGrid(image, noise, rows, index, valid)
    if grid.count < MIN_SURFELS:
        raise RegistrationError(
            f"the scan shows too little surface: {int(mask.sum())} readings of {image.ranges.size} "
            f"gave {grid.count} surfels, {MIN_SURFELS} are needed"
        )
    return grid


@dataclass(frozen=True)
class Used:
    """The part of a sweep from its first to its last line and beam with a reading: all that counts.

    Attributes:
        image: The sweep.
        part: Slices of its lines and beams.
        valid: Readings that are distances, of that part (n, m).
    """

    image: RangeImage
    part: tuple[slice, slice]
    valid: BoolArray

    @staticmethod
    def of(image: RangeImage, valid: BoolArray) -> Used:
        """Return the part of ``image`` with readings; one if there is none."""
        part = (_extent(np.any(valid, axis=1)), _extent(np.any(valid, axis=0)))
        return Used(image, part, np.ascontiguousarray(valid[part]))

    @cached_property
    def ranges(self) -> FloatArray:
        """Ranges of the part (n, m) [m]."""
        return np.array(self.image.ranges[self.part])

    @cached_property
    def yaws(self) -> FloatArray:
        """Yaws of the part (n, m) [rad]."""
        return np.array(self.image.yaws[self.part])

    def range_noise(self) -> ScanNoise:
        """Return the noise of the readings as they tell it themselves, or as usual."""
        estimated = estimate_range_noise(self.ranges, self.valid)
        if estimated is None:
            return ScanNoise()
        return replace(ScanNoise(), range_sigma=estimated[0], range_sigma_per_metre=estimated[1])

    def yaw_jitter(self, rows: FloatArray, index: SmallIntArray) -> float:
        """Return the jitter of the lines' yaws by the surfels of ``fit`` [rad]."""
        run = compiled("line_residuals") or line_residuals
        return yaw_jitter(run(self.ranges, self.yaws, _lever(self.image), rows, index))

    def fit(self, keep: BoolArray, noise: ScanNoise) -> tuple[FloatArray, SmallIntArray]:
        """Return what ``fit_surfels`` does, for the readings to ``keep`` (n_lines, n_beams)."""
        run, lever = compiled("fit_surfels") or fit_surfels, _lever(self.image)
        e, R = self.image.spec.elevations[self.part[1]], self.image.T_base_lidar[:3, :3]
        beams = np.cos(e)[:, None] * R[:, 0] + np.sin(e)[:, None] * R[:, 2]
        sigmas = np.array([noise.range_sigma, noise.range_sigma_per_metre])
        rows, index = run(
            self.ranges, self.yaws, beams, lever, self.valid, np.array(keep[self.part]),
            sigmas, _half_sizes(self.image),
        )  # fmt: skip
        return rows, index


def _extent(any_valid: npt.ArrayLike) -> slice:
    """Return the slice from the first to the last True; one entry if there is none."""
    used = np.flatnonzero(any_valid)
    return slice(used[0], used[-1] + 1) if len(used) else slice(0, 1)


def _lever(image: RangeImage) -> FloatArray:
    """Return the place of the lidar in ``base`` (3,) [m]."""
    return np.array(image.T_base_lidar[:3, 3])


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


def _half_sizes(image: RangeImage) -> IntArray:
    """Return the half sizes of the windows in lines and beams (4, 2), largest first."""
    steps = np.array([_line_spacing(image), median(np.abs(np.diff(image.spec.elevations)))])
    halves = np.round(np.array(WINDOWS)[:, None] / np.maximum(steps, 1e-4))
    sizes: IntArray = np.clip(halves, 1, 12).astype(np.int64)
    return sizes


def _line_spacing(image: RangeImage) -> float:
    return median(np.abs(np.diff(image.yaws[:, image.spec.n_beams // 2])))
