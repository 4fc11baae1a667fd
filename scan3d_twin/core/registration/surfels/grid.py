"""Surfels of a sweep on its grid of lines and beams, with edges and noise, for registration."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.line_grid import find_packed_columns, pack_columns
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.surfels.edges import Edges, find_edges
from scan3d_twin.core.registration.surfels.extraction import (
    UNKNOWN_RAY,
    Beams,
    X,
    classify_rays,
    make_native_sweep,
)
from scan3d_twin.core.registration.surfels.projection import Projection
from scan3d_twin.core.registration.surfels.scan_noise import BIAS_PATCH, NOISE_UNKNOWN, ScanNoise
from scan3d_twin.core.types import (
    UNMEASURED,
    BoolArray,
    FloatArray,
    RangeImage,
    Scan3D,
    SmallIntArray,
    read_only,
)

MIN_SURFELS = 50
"""Least number of surfels for a reliable registration."""
MIN_SAMPLE = 200
"""Least number of surfels in a thinned sample of a sweep that has this many."""
MAX_NOISE_RATIO = 1.5
"""Ratio of their range noises above which two sweeps keep their own (assumption)."""


@dataclass(frozen=True)
class Sample:
    """Every ``stride``-th surfel of a sweep, sorted by line.

    Attributes:
        whole: Surfels and yaws of the whole sweep, as in ``SurfelGrid``: (n, 8) and (n,).
        chosen: Row of each surfel of the sample among them (m,).
        lines: Its line (m,), ascending.
        stride: Stride along lines and beams: each surfel represents ``stride`` squared readings.
        value: The sample as the engine takes it.
    """

    whole: tuple[FloatArray, FloatArray]
    chosen: SmallIntArray
    lines: SmallIntArray
    stride: int
    value: native.Sample

    @cached_property
    def columns(self) -> FloatArray:
        """The surfels by column (8, m), as in ``surfels``."""
        return np.ascontiguousarray(self.whole[0].take(self.chosen, axis=0).T)

    @property
    def points(self) -> FloatArray:
        """Their points (m, 3) [m]."""
        return np.ascontiguousarray(self.whole[0].take(self.chosen, axis=0)[:, X])

    @property
    def rows(self) -> FloatArray:
        """The surfels (m, 8)."""
        return self.columns.T

    @cached_property
    def yaws(self) -> FloatArray:
        """Yaw at which each was measured, as in ``SurfelGrid`` (m,) [rad]."""
        return self.whole[1].take(self.chosen)

    def __len__(self) -> int:
        return len(self.chosen)


@dataclass(frozen=True)
class SurfelGrid:
    """Surfels of a sweep in frame ``scan``, on the grid of its lines and beams.

    Attributes:
        image: The sweep, its columns packed if it has several for each beam.
        noise: Noise of its readings.
        rows: Surfels (m, 8) line by line, columns as in ``surfels``.
        yaws: Yaw at which each was measured, from the mean yaw of the lines about heading 0, as
            far as there are lines to both sides, else of all (m,) [rad].
        index: Row of each reading's surfel (n_lines, n_beams), -1 where there is none.
        valid: Whether a reading is a distance (n_lines, n_beams).
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
        """Projection of a point onto the line and beam that see it."""
        return Projection.of(self.image, self.line_spacing)

    @cached_property
    def target(self) -> native.Target:
        """The sweep as the engine takes a registration's target."""
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
        """Vertical edges where surfaces end."""
        return Edges.of(self.edge_rows)

    @cached_property
    def edge_rows(self) -> FloatArray:
        """The edges as rows (n, 8), see ``Edges``."""
        return find_edges(self.image, self.rows, self.index, self.valid, self.noise.yaw_sigma)

    @cached_property
    def ray_states(self) -> native.ByteArray:
        """State of each reading's ray (n_lines * n_beams,): see ``classify_rays``.

        The grid of a turntable's sweep has cells that no beam looked into: they are unknown.
        """
        states = classify_rays(self.index, self.valid)
        if self.image.T_scan_axis is not None:
            states[self.image.codes.ravel() == UNMEASURED] = UNKNOWN_RAY
        return states

    @cached_property
    def inflation(self) -> float:
        """Inflation factor on the variance of a reading for the bias of its patch."""
        return self.noise.inflation(
            BIAS_PATCH**2 / (self.line_spacing * Beams.of(self.image).spacing)
        )

    def sample(self, stride: int) -> Sample:
        """Return every ``stride``-th surfel along lines and beams.

        The first is half a stride from the corner. The stride is reduced where it would leave fewer
        than about ``MIN_SAMPLE``, so that a small target keeps enough surfels.
        """
        stride = max(1, min(stride, math.isqrt(self.count // MIN_SAMPLE)))
        if stride not in self._samples:
            self._samples[stride] = self._sample(stride)
        return self._samples[stride]

    @cached_property
    def _samples(self) -> dict[int, Sample]:
        return {}

    def _sample(self, stride: int) -> Sample:
        n_lines, n_beams = self.index.shape
        most = min(self.count, (n_lines // stride + 1) * (n_beams // stride + 1))
        chosen, lines = np.empty(most, np.int32), np.empty(most, np.int32)
        value = native.Sample(
            stride=stride, rows=self.rows, yaws=self.yaws, chosen=chosen, lines=lines
        )
        engine.sample_surfels(self.index, n_lines, n_beams, value)
        n = value.count
        return Sample((self.rows, self.yaws), chosen[:n], lines[:n], stride, value)

    @property
    def count(self) -> int:
        """Number of surfels."""
        return len(self.rows)


def extract_surfels(
    image: RangeImage, *, keep: BoolArray | Scan3D | None = None, noise: ScanNoise | None = None
) -> SurfelGrid:
    """Return the surfels of ``image``, for any number of registrations.

    A grid with several columns for each beam of a line is packed (``core/line_grid.py``).

    Args:
        image: A sweep; filled gaps are not used.
        keep: Readings (n_lines, n_beams), or their points, that get a surfel; all by default.
        noise: Noise of the sweep; by default range noise and yaw jitter are estimated from it.

    Raises:
        RegistrationError: The sweep is empty or shows no surface.
        ConfigError: The image's parts do not fit together or its yaws are not finite.
    """
    _check(image)
    mask = _as_mask(keep, image.codes.shape)
    grid = _extract(image, mask, noise)

    # Pack a grid whose windows are half empty
    if 2 * grid.count < np.count_nonzero(grid.valid):
        columns = find_packed_columns(image.codes)
        if columns is not None:
            kept = None if mask is None else np.take_along_axis(mask, columns, axis=1)
            return extract_surfels(pack_columns(image, columns), keep=kept, noise=noise)
    if grid.count < MIN_SURFELS:
        wanted = grid.valid if mask is None else grid.valid & mask
        raise RegistrationError(
            f"the scan shows too little surface: {np.count_nonzero(wanted)} readings "
            f"of {image.ranges.size} gave {grid.count} surfels, {MIN_SURFELS} are needed"
        )
    return grid


def extract_pair(target: RangeImage, source: RangeImage) -> tuple[SurfelGrid, SurfelGrid]:
    """Return the surfels of two sweeps, both extracted with the larger of their two range noises.

    The noise decides how large a window may be, and larger planes lie deeper inside a round body,
    so that two estimates of one noise would shift it (docs/registration.md). Noises that differ by
    more than ``MAX_NOISE_RATIO`` are of two lidars.

    Raises:
        RegistrationError: A sweep is empty or shows no surface.
        ConfigError: An image's parts do not fit together or its yaws are not finite.
    """
    first, second = extract_surfels(target), extract_surfels(source)
    distance = float(np.mean(np.linalg.norm(first.rows[:, X], axis=1)))
    one, other = (grid.noise.range_sigma_at(distance) for grid in (first, second))
    if other < one <= MAX_NOISE_RATIO * other:
        second = extract_surfels(second.image, noise=second.noise.with_range_noise_of(first.noise))
    elif one < other <= MAX_NOISE_RATIO * one:
        first = extract_surfels(first.image, noise=first.noise.with_range_noise_of(second.noise))
    return first, second


def _extract(image: RangeImage, mask: BoolArray | None, noise: ScanNoise | None) -> SurfelGrid:
    """Return the surfels and the noise of a sweep, by ``native/extract_surfels.h``."""
    # Room for as many surfels as there are readings that want one.
    sweep, valid = make_native_sweep(image), np.empty(image.ranges.shape, np.bool_)
    codes = read_only(image.codes, np.int64)
    most = engine.mark_valid(read_only(image.ranges), codes, codes.size, valid)
    wanted = valid if mask is None else valid & mask
    most = most if mask is None else np.count_nonzero(wanted)
    rows, yaws = np.empty((most, 8)), np.empty(most)
    index = np.empty(image.ranges.shape, np.int32)

    # Extract surfels and, if unknown, noise.
    own = NOISE_UNKNOWN if image.noise is None else read_only(image.noise)
    known = own if noise is None else noise.values
    found = native.ScanSurfels(rows=rows, yaws=yaws, index=index, valid=valid, noise=known)
    if engine.extract_surfels(sweep, wanted, found) < 0:
        raise MemoryError

    # Keep what was written.
    noise = noise or ScanNoise.of(np.array(found.noise))
    n = found.count
    return SurfelGrid(image, noise, rows[:n], yaws[:n], index, valid, found.line_spacing)


def _check(image: RangeImage) -> None:
    shape = (image.n_lines, image.spec.n_beams)
    for name in ("yaws", "ranges", "codes", "elevations"):
        array = getattr(image, name)
        if array is not None and array.shape != shape:
            raise ConfigError(
                f"range image: {name} has shape {array.shape}, but expected are "
                f"{shape[0]} lines of {shape[1]} beams"
            )
    if min(shape) < 5:
        raise RegistrationError(f"a scan of {shape[0]} lines and {shape[1]} beams is too small")
    if not math.isfinite(image.yaws.sum()):
        raise ConfigError("range image: yaws must be finite")


def _as_mask(keep: BoolArray | Scan3D | None, shape: tuple[int, ...]) -> BoolArray | None:
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
