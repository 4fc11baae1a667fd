"""The target in horizontal slices: a place per line, and the edges where the target ends.

All readings of a line in a slice are pooled, so that noise and single wrong readings hardly tell:
the median of two dozen is known to a quarter of the noise of one. Registration needs edges that are
exact (``registration.edges``: a run of beams that all jump between the same two lines); here all of
them are wanted, exact to a line or two.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.planning.context import readings_of
from scan3d_twin.core.registration.edges import MIN_BEAMS, MIN_COSINE, MIN_RANGE_STEP, SURFEL_OFFSET
from scan3d_twin.core.session import View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2
from scan3d_twin.core.viewpoints import angle_between, clockwise

CARRIES = 0.25
"""Surface this near to an edge tells how the surface lies that ends there [m]; a few windows."""
COARSEST = 0.03
"""An edge is known to a line; where these are farther apart [m], as in a flat sight, too badly to
find that the face behind it was seen from elsewhere. As ``hidden.SEEN``."""
STRAIGHT = math.radians(10.0)
"""A surface whose halves differ by more is curved, and its outline no edge: a circle's of less than
0.7 m. Noise makes 2 deg."""
STEP = 0.06
"""A surface is gone that is followed by something so much farther than foreseen [m]: several times
what noise leaves, and what shows of a gap of 10 cm in a sight of 55 deg."""
MIN_LINES = 4
"""Fewer lines do not tell how a surface lies."""


@dataclass(frozen=True)
class Edge:
    """Where a surface ends in a slice, in ``scan``.

    Attributes:
        place: Top view (2,) [m].
        normal: Outward unit normal (2,) of the surface that ends.
        onwards: Unit vector (2,) along the surface, across its end.
        spacing: Of the lines on it [m]: how well the place is known.
    """

    place: FloatArray
    normal: FloatArray
    onwards: FloatArray
    spacing: float

    def seen_from(self, T: Pose2) -> Edge:
        """Return the edge in another frame; ``T`` maps into it."""
        place, normal, onwards = T.apply(self.place), T.rotate(self.normal), T.rotate(self.onwards)
        return Edge(place, normal, onwards, self.spacing)


@dataclass(frozen=True)
class Profile:
    """What a view saw in a slice, one place per line, left to right; in ``scan``.

    Attributes:
        places: Top view of the median reading (n_lines, 2) [m]; NaN where there are too few.
        on_target: Whether it is surface of the target (n_lines,); not next to where a surface ends:
            a line there may be half on it and half beyond.
    """

    places: FloatArray
    on_target: BoolArray

    @staticmethod
    def through(view: View, heights: Sequence[float], thickness: float) -> list[Profile]:
        """Return the profiles of ``view`` in the slices about ``heights`` [m]."""
        points = view.image.points
        ahead, left, up = np.ascontiguousarray(np.moveaxis(points, 2, 0))
        swept, target = (readings_of(scan, view.image) for scan in (view.sweep, view.target))
        away = np.where(swept, np.hypot(ahead, left), np.inf)
        lines, found = np.arange(len(points)), []
        for height in heights:
            with np.errstate(invalid="ignore"):
                within = swept & (np.abs(up - height) <= thickness / 2)
            count = within.sum(axis=1)
            middle: IntArray = np.maximum(count - 1, 0) // 2
            beams = np.argsort(np.where(within, away, np.inf), axis=1)[lines, middle]
            enough = count >= MIN_BEAMS
            places = np.where(enough[:, None], points[lines, beams, :2], np.nan)
            ends = _beside_ends(np.linalg.norm(places, axis=1))
            found.append(Profile(places, enough & target[lines, beams] & ~ends))
        return found

    def edges(self) -> Iterator[Edge]:
        """Yield where the target ends, towards the right first."""
        for side in (1, -1):
            places, on_target = self.places[::side], self.on_target[::side]
            for k in np.flatnonzero(_ends(np.linalg.norm(places, axis=1))):
                if on_target[max(0, int(k) - SURFEL_OFFSET)]:
                    edge = _edge(places[: k + 1], side)
                    if edge is not None:
                        yield edge


def _edge(places: FloatArray, side: int) -> Edge | None:
    """Return the edge at the end of ``places`` (n, 2); None if it was not seen well.

    ``side`` is 1 where the surface ends to the right, -1 to the left.
    """
    end, surface = places[-1], _last_surface(places)
    if len(surface) < MIN_LINES or _bend(surface) > STRAIGHT:
        return None
    spacing = float(np.linalg.norm(surface[-1] - surface[0])) / (len(surface) - 1)
    onwards = _direction(surface)
    normal = side * clockwise(onwards)
    ray = end / np.linalg.norm(end)
    if -normal @ ray <= MIN_COSINE or spacing > COARSEST:
        return None
    reach = float(np.median(surface @ normal)) / float(normal @ ray)
    return Edge(reach * ray + spacing / 2 * onwards, normal, onwards, spacing)


def _last_surface(places: FloatArray) -> FloatArray:
    """Return those of ``places`` (n, 2) on one surface near the last, less ``SURFEL_OFFSET``."""
    surface = places[:-SURFEL_OFFSET]
    steps = np.abs(np.diff(np.linalg.norm(surface, axis=1)))
    breaks = np.flatnonzero(~(steps <= MIN_RANGE_STEP))
    surface = surface[breaks[-1] + 1 if len(breaks) else 0 :]
    return np.asarray(surface[np.linalg.norm(surface - places[-1], axis=1) <= CARRIES])


def _beside_ends(away: FloatArray) -> BoolArray:
    """Tell which lines (n,) are the last of a surface or the next after it."""
    right, left = _ends(away), _ends(away[::-1])[::-1]
    result = right | left
    result[1:] |= right[:-1]
    result[:-1] |= left[1:]
    return result


def _ends(away: FloatArray) -> BoolArray:
    """Tell after which lines (n,) the surface is gone, by how far ``away`` each is (n,) [m].

    NaN is nothing there; beyond the border may be more. The surface is gone where the line after
    the next is farther than the surface would be if it went on as steeply. The next line may be
    half on it, half beyond.
    """
    foreseen = np.full(len(away), np.inf)
    foreseen[2:] = away[2:] + np.fmax(away[2:] - away[:-2], 0.0)
    foreseen[:2] = away[:2]
    gone = np.isfinite(away)
    gone[:-2] &= ~(away[2:] - foreseen[:-2] <= STEP)
    gone[-2:] = False
    gone[:-1] &= ~gone[1:]
    return gone


def _bend(points: FloatArray) -> float:
    """Return by how much the halves of ``points`` (n, 2) differ in direction [rad]; 0 for a few."""
    half = len(points) // 2
    if half < MIN_LINES:
        return 0.0
    return abs(angle_between(_direction(points[:half]), _direction(points[half:])))


def _direction(points: FloatArray) -> FloatArray:
    """Return the unit vector (2,) along ``points`` (n, 2): Theil's median of all pairs."""
    i, j = np.triu_indices(len(points), 1)
    steps = points[j] - points[i]
    along = math.atan2(*(points[-1] - points[0])[::-1])
    turns = np.arctan2(steps[:, 1], steps[:, 0]) - along
    angle = along + float(np.median((turns + np.pi) % math.tau - np.pi))
    return np.array([math.cos(angle), math.sin(angle)])
