"""The top view of a run as SVG, in the manner of the paper's Figs. 11 and 14.

Points coloured by view, a numbered star at each viewpoint, its scan sector dashed, axes in metres;
the way that was driven with arrows and, in the twin, the true shape of the target from above.
The picture needs no fonts or scripts from outside and follows the reader's light or dark scheme.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray, Pose2
from scan3d_twin.recording.colours import view_colour

WIDTH, MARGIN, TITLE_HEIGHT = 900.0, 60.0, 34.0
"""Dimensions of the picture, in its own units."""
MIN_HEIGHT, MAX_HEIGHT = 320.0, 1200.0
POINT_SIZE = 2.2
SHAPE_CELL, ARROW_STEP = 5.0, 90.0
"""Side of the cells of the true shape, and distance between arrows, in units of the picture."""
MAX_POINTS = 60_000
"""Most points of the picture; keeps the file under 2 MB."""
STYLE = """
svg { background: #ffffff; font: 13px system-ui, "Helvetica Neue", Arial, sans-serif; }
.paper { fill: #ffffff; } .frame { fill: none; stroke: #57606a; }
.grid { stroke: #d8dee4; } text { fill: #1f2328; } .tick { font-size: 12px; fill: #57606a; }
.sector { fill: none; stroke-width: 1.3; stroke-dasharray: 6 4; }
.star { stroke: #ffffff; stroke-width: 1; } .bar { stroke: #1f2328; stroke-width: 3; }
.label { font-weight: 600; paint-order: stroke; stroke: #ffffff; stroke-width: 3px; }
.way { fill: none; stroke: #8b949e; stroke-width: 2; stroke-linejoin: round; }
.arrow { fill: #8b949e; } .truth { fill: none; stroke: #e3e6ea; }
@media (max-width: 560px) { text, .tick { font-size: 18px; } }
@media (prefers-color-scheme: dark) {
.truth { stroke: #2a313b; }
svg { background: #0d1117; } .paper { fill: #0d1117; } .frame { stroke: #9198a1; }
.grid { stroke: #262c36; } text { fill: #f0f6fc; } .tick { fill: #9198a1; }
.star, .label { stroke: #0d1117; } .bar { stroke: #f0f6fc; }
}"""


@dataclass(frozen=True, slots=True)
class _Frame:
    """The shown part of the world and its place in the picture."""

    x_min: float
    y_max: float
    scale: float
    width: float
    height: float

    def x(self, value: Any) -> Any:
        return MARGIN + self.scale * (value - self.x_min)

    def y(self, value: Any) -> Any:
        return TITLE_HEIGHT + self.scale * (self.y_max - value)

    @property
    def x_max(self) -> float:
        return self.x_min + self.width / self.scale

    @property
    def y_min(self) -> float:
        return self.y_max - self.height / self.scale


def draw_top_view(
    points: FloatArray,
    view: IntArray,
    viewpoints: Sequence[Pose2],
    *,
    sweep_width: float,
    standoff: float,
    title: str,
    way: FloatArray | None = None,
    truth: FloatArray | None = None,
) -> str:
    """Return the top view as an SVG document.

    Args:
        points: The model (n, 2 or 3) in ``world`` [m].
        view: Index of the view each point came from (n,).
        viewpoints: ``T_world_scan`` of each view.
        sweep_width: Horizontal angle of a sweep [rad].
        standoff: Distance at which the surface is expected [m]; the sectors are a quarter longer.
        title: One line above the picture.
        way: Places where the robot drove, in order (n, 2) in ``world`` [m].
        truth: Samples of the true surface (n, 2 or 3) in ``world`` [m].
    """
    # Lay out the picture
    reach = 1.25 * standoff
    way = np.zeros((0, 2)) if way is None else way
    frame = _frame(points, way, viewpoints, sweep_width, reach)
    total = frame.height + TITLE_HEIGHT + MARGIN

    # Draw from back to front
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:g} {total:.0f}" role="img">',
        f"<title>{escape(title)}</title><style>{STYLE}</style>",
        f'<rect class="paper" width="{WIDTH:g}" height="{total:.0f}"/>',
        f'<text x="{MARGIN:g}" y="22" font-size="15" font-weight="600">{escape(title)}</text>',
        *_axes(frame),
        *_shape(frame, np.zeros((0, 2)) if truth is None else truth[:, :2]),
        *_way(frame, way),
        *_sectors(frame, viewpoints, sweep_width, reach),
        *_points(frame, points, view),
        *_stars(frame, viewpoints),
        *_scale_bar(frame),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _frame(
    points: FloatArray,
    way: FloatArray,
    viewpoints: Sequence[Pose2],
    sweep_width: float,
    reach: float,
) -> _Frame:
    """Return a frame around all points, the way and the sectors, with a border."""
    # Bound all that is shown
    corners = [_sector_points(pose, sweep_width, reach) for pose in viewpoints]
    seen = np.concatenate([points[:, :2], way, *corners])
    low, high = seen.min(axis=0) - 0.15, seen.max(axis=0) + 0.15

    # Fit the scale to both axes
    width = WIDTH - MARGIN - 20.0
    scale = min(width / (high[0] - low[0]), MAX_HEIGHT / (high[1] - low[1]))
    height = max(MIN_HEIGHT, scale * (high[1] - low[1]))

    # Centre the content
    middle = (low + high) / 2
    return _Frame(
        x_min=float(middle[0] - width / scale / 2),
        y_max=float(middle[1] + height / scale / 2),
        scale=float(scale),
        width=width,
        height=float(height),
    )


def _sector_points(pose: Pose2, width: float, reach: float) -> FloatArray:
    """Return the outline of a sector: its tip and points along its arc (n, 2) [m]."""
    angles = np.linspace(width / 2, -width / 2, max(2, math.ceil(width / math.radians(5)) + 1))
    arc = reach * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return pose.apply(np.concatenate([np.zeros((1, 2)), arc]))


def _points(frame: _Frame, points: FloatArray, view: IntArray) -> list[str]:
    """Return one path of dots per view, one dot per occupied cell of the picture."""
    # One dot per occupied cell
    size = POINT_SIZE / 2 / frame.scale
    cells = np.column_stack([view, np.round(points[:, :2] / size).astype(np.int64)])
    cells = np.unique(cells, axis=0)
    cells = cells[:: max(1, math.ceil(len(cells) / MAX_POINTS))]

    # Draw one path per view
    parts = []
    for index in np.unique(cells[:, 0]):
        dots = size * cells[cells[:, 0] == index, 1:]
        path = "".join(f"M{frame.x(x):.1f} {frame.y(y):.1f}h0" for x, y in dots)
        parts.append(
            f'<path d="{path}" stroke="{view_colour(int(index))}" stroke-width="{POINT_SIZE}" '
            f'stroke-linecap="round" fill="none"/>'
        )
    return parts


def _shape(frame: _Frame, points: FloatArray) -> list[str]:
    """Return the area that the surface covers from above, as runs of cells along x."""
    size = SHAPE_CELL / frame.scale
    inside = (points >= [frame.x_min, frame.y_min]) & (points <= [frame.x_max, frame.y_max])
    cells = np.unique(np.floor(points[inside.all(axis=1), ::-1] / size).astype(np.int64), axis=0)
    if len(cells) == 0:
        return []

    # Join neighbours to runs
    breaks = (np.diff(cells[:, 0]) != 0) | (np.diff(cells[:, 1]) > 1)
    first = np.flatnonzero(np.append(True, breaks))
    last = np.flatnonzero(np.append(breaks, True))
    runs = "".join(
        f"M{frame.x(size * cells[a, 1]):.1f} {frame.y(size * (cells[a, 0] + 0.5)):.1f}"
        f"h{SHAPE_CELL * (cells[b, 1] + 1 - cells[a, 1]):.1f}"
        for a, b in zip(first, last, strict=True)
    )
    return [f'<path class="truth" d="{runs}" stroke-width="{SHAPE_CELL:g}"/>']


def _way(frame: _Frame, places: FloatArray) -> list[str]:
    """Return the way through ``places`` (n, 2) [m], with an arrow every so often."""
    if len(places) < 2:
        return []
    line = np.column_stack([frame.x(places[:, 0]), frame.y(places[:, 1])])
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    parts = [f'<path class="way" d="M{"L".join(f"{x:.1f} {y:.1f}" for x, y in line)}"/>']
    for at in np.arange(ARROW_STEP / 2, length[-1], ARROW_STEP):
        k = max(1, int(np.searchsorted(length, at)))
        (x0, y0), (x, y) = line[k - 1], line[k]
        turn = math.degrees(math.atan2(y - y0, x - x0))
        parts.append(
            f'<path class="arrow" d="M6 0L-6 -5L-6 5z" transform="translate({x:.1f} {y:.1f}) '
            f'rotate({turn:.0f})"/>'
        )
    return parts


def _sectors(frame: _Frame, viewpoints: Sequence[Pose2], width: float, reach: float) -> list[str]:
    parts = []
    for index, pose in enumerate(viewpoints):
        outline = _sector_points(pose, width, reach)
        corners = " ".join(f"{frame.x(x):.1f},{frame.y(y):.1f}" for x, y in outline)
        parts.append(f'<polygon class="sector" points="{corners}" stroke="{view_colour(index)}"/>')
    return parts


def _stars(frame: _Frame, viewpoints: Sequence[Pose2]) -> list[str]:
    """Return a star at each viewpoint, with its number behind it."""
    parts = []
    for index, pose in enumerate(viewpoints):
        # Draw a star of five tips
        x, y = frame.x(pose.x), frame.y(pose.y)
        tips = " ".join(
            f"{x + r * math.sin(a):.1f},{y - r * math.cos(a):.1f}"
            for a, r in ((math.tau * k / 10, 4.0 if k % 2 else 10.0) for k in range(10))
        )
        parts.append(f'<polygon class="star" points="{tips}" fill="{view_colour(index)}"/>')

        # Draw its number behind it
        tx, ty = x - 19 * math.cos(pose.yaw), y + 19 * math.sin(pose.yaw) + 4.5
        parts.append(
            f'<text class="label" x="{tx:.1f}" y="{ty:.1f}" text-anchor="middle">{index}</text>'
        )
    return parts


def _axes(frame: _Frame) -> list[str]:
    """Return grid, frame and ticks in metres."""
    # Choose the tick distance
    left, top = MARGIN, TITLE_HEIGHT
    bottom, right = top + frame.height, left + frame.width
    step = _round_step(100.0 / frame.scale)
    digits = max(0, -math.floor(math.log10(step)))

    # Draw vertical grid lines
    parts = []
    for value in _multiples(step, frame.x_min, frame.x_max):
        x = frame.x(value)
        parts.append(f'<path class="grid" d="M{x:.1f} {top:g}V{bottom:.1f}"/>')
        parts.append(
            f'<text class="tick" x="{x:.1f}" y="{bottom + 18:.1f}" text-anchor="middle">'
            f"{value:.{digits}f}</text>"
        )

    # Draw horizontal grid lines
    for value in _multiples(step, frame.y_min, frame.y_max):
        y = frame.y(value)
        parts.append(f'<path class="grid" d="M{left:g} {y:.1f}H{right:.1f}"/>')
        parts.append(
            f'<text class="tick" x="{left - 8:g}" y="{y + 4:.1f}" text-anchor="end">'
            f"{value:.{digits}f}</text>"
        )

    # Draw frame and labels
    middle = top + frame.height / 2
    parts += [
        f'<rect class="frame" x="{left:g}" y="{top:g}" width="{frame.width:g}" '
        f'height="{frame.height:.1f}"/>',
        f'<text x="{left + frame.width / 2:.1f}" y="{bottom + 42:.1f}" text-anchor="middle">'
        "x [m]</text>",
        f'<text transform="translate(15 {middle:.1f}) rotate(-90)" text-anchor="middle">'
        "y [m]</text>",
    ]
    return parts


def _scale_bar(frame: _Frame) -> list[str]:
    """Return a bar of a round length below the lower right corner."""
    length = _round_step(60.0 / frame.scale)
    right, y = MARGIN + frame.width, TITLE_HEIGHT + frame.height + 46
    left = right - length * frame.scale
    words = f"{length:g} m" if length >= 1 else f"{100 * length:g} cm"
    return [
        f'<path class="bar" d="M{left:.1f} {y:.1f}H{right:.1f}"/>',
        f'<text class="label" x="{(left + right) / 2:.1f}" y="{y - 8:.1f}" '
        f'text-anchor="middle">{words}</text>',
    ]


def _round_step(length: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is at least ``length``."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= length)


def _multiples(step: float, low: float, high: float) -> list[float]:
    """Return the multiples of ``step`` from ``low`` to ``high``; zero without a sign."""
    return [k * step + 0.0 for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
