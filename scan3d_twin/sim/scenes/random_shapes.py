"""Shapes of random targets, built of solids on the floor.

A shape is a list of solids in the target's own frame: the robot looks along +x, so that fronts face
-x; y runs across. Lengths in m.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray, Pose2
from scan3d_twin.sim.scenes.random_ranges import SceneRanges, Shape

FACET_WIDTH = 0.005
"""Width of a facet of a wavy side [m]; the chord of the sharpest wave is off by less than .5 mm."""
FACET_ROWS = 7
"""Rows of facets of a wavy side: MuJoCo casts rays slowly against long thin triangles."""
LEG_SHARE = 0.35
"""Thickness of the legs of an L or U as a share of its width or depth; assumption."""


@dataclass(frozen=True, slots=True)
class Solid:
    """A box, a cylinder or a prism.

    Attributes:
        kind: Kind of the solid.
        place: Pose of its base in the target's frame.
        size: Half extents of a box or prism; radius, radius and half height of a cylinder (3,).
        bottom: Height of its base.
        mesh: Vertices (n, 3) about the middle, and faces (m, 3), of a prism.
    """

    kind: Literal["box", "cylinder", "prism"]
    place: Pose2
    size: tuple[float, float, float]
    bottom: float = 0.0
    mesh: tuple[FloatArray, IntArray] | None = None

    def corners(self) -> FloatArray:
        """Return the corners (4, 2) of its footprint's bounding box, in the target's frame."""
        signs = np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)])
        return self.place.apply(signs * self.size[:2])

    def moved(self, by: Pose2) -> Solid:
        """Return the solid moved by the pose ``by``."""
        return replace(self, place=by @ self.place)


Builder = Callable[[np.random.Generator, SceneRanges, float], list[Solid]]


def build_shape(name: Shape, rng: np.random.Generator, ranges: SceneRanges) -> list[Solid]:
    """Return a random target of the shape ``name``, the middle of its footprint at the origin."""
    return _centre(_BUILDERS[name](rng, ranges, draw_uniform(rng, ranges.width)))


def draw_uniform(rng: np.random.Generator, interval: tuple[float, float]) -> float:
    """Return a uniform draw from ``interval``."""
    return float(rng.uniform(*interval))


def _centre(solids: list[Solid]) -> list[Solid]:
    corners = np.concatenate([solid.corners() for solid in solids])
    x, y = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return [solid.moved(Pose2(-x, -y)) for solid in solids]


def _upright(x: float, y: float, depth: float, width: float, height: float) -> Solid:
    """Return a box on the floor, its front at ``x`` and its middle at ``y``."""
    return Solid("box", Pose2(x + depth / 2, y), (depth / 2, width / 2, height / 2))


def _box(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    return [
        _upright(0.0, 0.0, draw_uniform(rng, ranges.depth), width, draw_uniform(rng, ranges.height))
    ]


def _boxes(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return two to four boxes in a row with different setbacks, as in the paper's Fig. 13."""
    # Draw widths and gaps
    count = int(rng.integers(2, 5))
    shares = rng.uniform(0.5, 1.5, count)
    gap = min(draw_uniform(rng, ranges.gap), width / (2 * count))
    widths = shares / shares.sum() * (width - (count - 1) * gap)

    # Add boxes from left to right
    solids, y = [], 0.0
    for own in widths:
        back, depth = draw_uniform(rng, ranges.setback), draw_uniform(rng, ranges.depth)
        solids.append(
            _upright(back, y + own / 2, depth, float(own), draw_uniform(rng, ranges.height))
        )
        y += float(own) + gap
    return solids


def _cylinder(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    radius, height = (
        min(width / 2, draw_uniform(rng, ranges.radius)),
        draw_uniform(rng, ranges.height),
    )
    return [Solid("cylinder", Pose2(), (radius, radius, height / 2))]


def _sine(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return a box whose front is a sine, as the paper's Fig. 10."""
    depth, height = draw_uniform(rng, ranges.depth), draw_uniform(rng, ranges.height)
    mesh = _wavy_box(
        (depth, width, height),
        draw_uniform(rng, ranges.amplitude),
        draw_uniform(rng, ranges.period),
    )
    half = np.abs(mesh[0]).max(axis=0)
    return [Solid("prism", Pose2(), (float(half[0]), width / 2, height / 2), mesh=mesh)]


def _wavy_box(
    extent: tuple[float, float, float], amplitude: float, period: float
) -> tuple[FloatArray, IntArray]:
    """Return vertices (n, 3) about the middle and outward faces (m, 3) of a box with a wavy -x."""
    # Outline the box from above
    depth, width, height = extent
    columns = max(2, math.ceil(width / FACET_WIDTH))
    y = np.linspace(-width / 2, width / 2, columns + 1)
    wave = amplitude * np.sin(math.tau * y / period) - depth / 2
    # Counter-clockwise from above: down the wavy side, then up the straight one.
    ring = np.concatenate([np.stack([wave, y], axis=1)[::-1], [(depth / 2, v) for v in y]])

    # Stack the outline level by level
    levels = np.linspace(-height / 2, height / 2, FACET_ROWS + 1)
    vertices = np.concatenate([np.column_stack([ring, np.full(len(ring), z)]) for z in levels])

    # Triangulate the sides
    n = len(ring)
    a = (np.arange(FACET_ROWS)[:, None] * n + np.arange(n)).ravel()
    b = (np.arange(FACET_ROWS)[:, None] * n + (np.arange(n) + 1) % n).ravel()
    sides = [np.stack([a, b, b + n], axis=1), np.stack([a, b + n, a + n], axis=1)]

    # Triangulate floor and top
    front = np.arange(columns)  # edge k of the wave runs from column k to k + 1, falling in y
    back = n - 1 - front  # the straight side's vertex behind the same place
    floor = [
        np.stack([front, back, front + 1], axis=1),
        np.stack([front + 1, back, back - 1], axis=1),
    ]
    top = [face[:, ::-1] + FACET_ROWS * n for face in floor]
    return vertices, np.concatenate([*sides, *floor, *top]).astype(np.int64)


def _steps(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return a flight of steps, each a box from the floor up."""
    count = int(rng.integers(2, 5))
    rise, going = draw_uniform(rng, ranges.rise), draw_uniform(rng, ranges.going)
    return [
        _upright(k * going, 0.0, (count - k) * going, width, (k + 1) * rise) for k in range(count)
    ]


def _l_shape(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return an L from above, its inner corner towards the robot."""
    depth, height = draw_uniform(rng, ranges.depth), draw_uniform(rng, ranges.height)
    back, side = LEG_SHARE * depth, LEG_SHARE * width
    left = bool(rng.integers(2))
    y = (width - side) / 2 * (1 if left else -1)
    leg = _upright(0.0, y, depth - back, side, height)
    return [_upright(depth - back, 0.0, back, width, height), leg]


def _u_shape(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return a U from above, open towards the robot."""
    depth, height = draw_uniform(rng, ranges.depth), draw_uniform(rng, ranges.height)
    back, side = LEG_SHARE * depth, LEG_SHARE * width / 2
    legs = [_upright(0.0, s * (width - side) / 2, depth - back, side, height) for s in (-1, 1)]
    return [_upright(depth - back, 0.0, back, width, height), *legs]


def _combination(rng: np.random.Generator, ranges: SceneRanges, width: float) -> list[Solid]:
    """Return two simple shapes side by side."""
    gap = min(draw_uniform(rng, ranges.gap), width / 4)
    solids: list[Solid] = []
    y = 0.0

    # Add parts from left to right
    for name in rng.choice(("box", "cylinder", "sine", "l_shape"), 2):
        parts = _centre(_BUILDERS[name](rng, ranges, (width - gap) / 2))
        extent = np.concatenate([part.corners() for part in parts])
        low, high = extent.min(axis=0), extent.max(axis=0)
        x = draw_uniform(rng, ranges.setback) - float(low[0])
        solids += [part.moved(Pose2(x, y - float(low[1]))) for part in parts]
        y += float(high[1] - low[1]) + gap
    return solids


_BUILDERS: dict[Any, Builder] = {
    "box": _box,
    "boxes": _boxes,
    "cylinder": _cylinder,
    "sine": _sine,
    "steps": _steps,
    "l_shape": _l_shape,
    "u_shape": _u_shape,
    "combination": _combination,
}
