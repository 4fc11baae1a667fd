"""Profiles of the target in horizontal slices: one place per line, and the edges where it ends.

The place of a line is the median of its readings in the slice, so that noise and single wrong
readings have little influence: the median of two dozen has a quarter of the noise of one. While
registration needs exact edges (``registration.edges``: a run of beams that all jump between the
same two lines), here all edges are found, exact to one or two lines.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from scan3d_twin.core.planning.context import mask_readings
from scan3d_twin.core.registration.surfels.edges import (
    MIN_BEAMS,
    MIN_EDGE_COSINE,
    MIN_RANGE_STEP,
    SURFEL_OFFSET,
)
from scan3d_twin.core.session import View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2
from scan3d_twin.core.viewpoints import measure_angle, rotate_clockwise

SURFACE_REACH = 0.25
"""Distance from an edge within which surface gives the direction of what ends there [m]; a few
windows."""
MAX_LINE_SPACING = 0.03
"""Line spacing above which an edge is too inexact [m]: edges are known to one line, and the face
behind one must be found again in another view. As ``hidden_surface.SETTLED_DISTANCE``."""
STRAIGHT_ANGLE = math.radians(10.0)
"""Angle between the halves of a surface above which it is curved [rad], so that its outline is no
edge: a circle of less than 0.7 m. Noise makes 2 deg."""
MIN_DEPTH_STEP = 0.06
"""Step in distance, beyond the extrapolated surface, at which a surface ends [m]: several times the
noise, and the depth of a gap of 10 cm seen at 55 deg."""
MIN_LINES = 4
"""Smallest number of lines to which a direction is fitted."""


@dataclass(frozen=True)
class Edge:
    """Where a surface ends in a slice, in ``scan``.

    Attributes:
        place: Its place in the top view (2,) [m].
        normal: Outward unit normal (2,) of the surface that ends.
        onwards: Unit vector (2,) along the surface, out across its end.
        spacing: Line spacing on the surface, the uncertainty of the place [m].
    """

    place: FloatArray
    normal: FloatArray
    onwards: FloatArray
    spacing: float

    def seen_from(self, T: Pose2) -> Edge:
        """Return the edge in frame a of ``T_a_scan``."""
        place, normal, onwards = T.apply(self.place), T.rotate(self.normal), T.rotate(self.onwards)
        return Edge(place, normal, onwards, self.spacing)


@dataclass(frozen=True)
class Profile:
    """The profile of a view in a slice, one place per line, left to right; in ``scan``.

    Attributes:
        places: Top view of the median reading (n_lines, 2) [m]; NaN for too few readings.
        on_target: Whether the place is on the target's surface (n_lines,); False next to the end of
            a surface, where a line may be half on it and half beyond.
    """

    places: FloatArray
    on_target: BoolArray

    @staticmethod
    def through(view: View, heights: Sequence[float], thickness: float) -> list[Profile]:
        """Return the profiles of ``view`` in the slices at ``heights`` [m]."""
        # Measure all readings in the top view
        points = view.image.points
        ahead, left, up = np.ascontiguousarray(np.moveaxis(points, 2, 0))
        swept, target = (mask_readings(scan, view.image) for scan in (view.sweep, view.target))
        away = np.where(swept, np.hypot(ahead, left), np.inf)
        lines, found = np.arange(len(points)), []
        for height in heights:
            with np.errstate(invalid="ignore"):
                within = swept & (np.abs(up - height) <= thickness / 2)

            # Choose the median reading per line
            count = within.sum(axis=1)
            middle: IntArray = np.maximum(count - 1, 0) // 2
            beams = _find_ranked(np.where(within, away, np.inf), middle)
            enough = count >= MIN_BEAMS

            # Leave out lines beside ends
            places = np.where(enough[:, None], points[lines, beams, :2], np.nan)
            ends = _find_beside_ends(np.linalg.norm(places, axis=1))
            found.append(Profile(places, enough & target[lines, beams] & ~ends))
        return found

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """The edges of the target, those on the right first."""
        return tuple(self._find_edges())

    def _find_edges(self) -> Iterator[Edge]:
        for side in (1, -1):
            places, on_target = self.places[::side], self.on_target[::side]
            for k in np.flatnonzero(_find_ends(np.linalg.norm(places, axis=1))):
                if on_target[max(0, int(k) - SURFEL_OFFSET)]:
                    edge = _fit_edge(places[: k + 1], side)
                    if edge is not None:
                        yield edge


def _find_ranked(values: FloatArray, ranks: IntArray) -> IntArray:
    """Return the column (m,) of each row's value of rank ``ranks`` (m,) among ``values`` (m, n).

    Columns without a finite value are not sorted; where a row has none, any column is returned.
    """
    used = np.flatnonzero(np.isfinite(values).any(axis=0))
    if len(used) == 0:
        return np.zeros(len(values), dtype=np.int64)
    order = np.argsort(values[:, used], axis=1)
    return np.asarray(used[order[np.arange(len(values)), ranks]])


def _fit_edge(places: FloatArray, side: int) -> Edge | None:
    """Return the edge at the end of a surface; None if it was not seen well.

    Args:
        places: Places up to the end (n, 2) [m].
        side: 1 where the surface ends on the right, -1 on the left.
    """
    # Require a straight surface
    end, surface = places[-1], _select_last_surface(places)
    if len(surface) < MIN_LINES or _measure_bend(surface) > STRAIGHT_ANGLE:
        return None

    # Require a good view of it
    spacing = float(np.linalg.norm(surface[-1] - surface[0])) / (len(surface) - 1)
    onwards = _fit_direction(surface)
    normal = side * rotate_clockwise(onwards)
    ray = end / np.linalg.norm(end)
    if -normal @ ray <= MIN_EDGE_COSINE or spacing > MAX_LINE_SPACING:
        return None

    # Extend it to the last ray
    reach = float(np.median(surface @ normal)) / float(normal @ ray)
    return Edge(reach * ray + spacing / 2 * onwards, normal, onwards, spacing)


def _select_last_surface(places: FloatArray) -> FloatArray:
    """Return the places (k, 2) on the surface that ends ``places`` (n, 2), near its end.

    The last ``SURFEL_OFFSET`` places are left out, as they may be half beyond the surface.
    """
    surface = places[:-SURFEL_OFFSET]
    steps = np.abs(np.diff(np.linalg.norm(surface, axis=1)))
    breaks = np.flatnonzero(~(steps <= MIN_RANGE_STEP))
    surface = surface[breaks[-1] + 1 if len(breaks) else 0 :]
    return np.asarray(surface[np.linalg.norm(surface - places[-1], axis=1) <= SURFACE_REACH])


def _find_beside_ends(away: FloatArray) -> BoolArray:
    """Return which lines (n,) are the last of a surface or the next after it."""
    right, left = _find_ends(away), _find_ends(away[::-1])[::-1]
    result = right | left
    result[1:] |= right[:-1]
    result[:-1] |= left[1:]
    return result


def _find_ends(away: FloatArray) -> BoolArray:
    """Return which lines (n,) are the last of a surface.

    A surface ends where the line after the next is farther than the surface extrapolated with the
    same slope; the next line may be half on it, half beyond. At the border of the sweep a surface
    may go on.

    Args:
        away: Distance of each line's place (n,) [m]; NaN for none.
    """
    # Extrapolate over two lines
    expected = np.full(len(away), np.inf)
    expected[2:] = away[2:] + np.fmax(away[2:] - away[:-2], 0.0)
    expected[:2] = away[:2]

    # Compare with what follows
    ends = np.isfinite(away)
    ends[:-2] &= ~(away[2:] - expected[:-2] <= MIN_DEPTH_STEP)
    ends[-2:] = False
    ends[:-1] &= ~ends[1:]
    return ends


def _measure_bend(points: FloatArray) -> float:
    """Return the angle between the halves of ``points`` (n, 2) [rad]; 0 for too few points."""
    half = len(points) // 2
    if half < MIN_LINES:
        return 0.0
    return abs(measure_angle(_fit_direction(points[:half]), _fit_direction(points[half:])))


def _fit_direction(points: FloatArray) -> FloatArray:
    """Return the unit vector (2,) along ``points`` (n, 2): the median of all pairs (Theil-Sen)."""
    i, j = np.triu_indices(len(points), 1)
    steps = points[j] - points[i]
    along = math.atan2(*(points[-1] - points[0])[::-1])
    turns = np.arctan2(steps[:, 1], steps[:, 0]) - along
    angle = along + float(np.median((turns + np.pi) % math.tau - np.pi))
    return np.array([math.cos(angle), math.sin(angle)])
