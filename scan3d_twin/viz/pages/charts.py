"""Small line charts as inline SVG; colours and fonts come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from xml.sax.saxutils import escape

LEFT, RIGHT, TOP, BOTTOM = 68.0, 12.0, 12.0, 40.0
"""Margins of the plot [units of the picture]."""


@dataclass(frozen=True, slots=True)
class Dot:
    """A point of a chart.

    Attributes:
        x: Horizontal position in data units.
        y: Vertical position in data units; above the axis it is drawn as an arrow at the edge.
        colour: Colour as #rrggbb.
        label: A few letters beside it; none if empty.
        filled: Whether it is filled; otherwise a ring.
        title: Tooltip; none if empty.
    """

    x: float
    y: float
    colour: str
    label: str = ""
    filled: bool = True
    title: str = ""


@dataclass(frozen=True, slots=True)
class Series:
    """A further line of a chart.

    Attributes:
        dots: Dots from left to right, joined by a line where ``y`` is known.
        colour: Colour of the line as #rrggbb.
    """

    dots: Sequence[Dot]
    colour: str


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart of a line with its dots, and of further ones.

    Attributes:
        title: Title for screen readers.
        x_label: Label of the x axis, with its unit.
        y_label: Label of the y axis, with its unit.
        x_range: Ends of the x axis.
        y_range: Ends of the y axis.
        dots: Dots from left to right, joined by a line where ``y`` is known.
        limit: Height of a dashed line; None for none.
        limit_label: Label of that line.
        percent: The axes whose ticks are shares: any of "x", "y".
        width: Width [units of the picture].
        height: Height [units of the picture].
        colour: Colour of the line as #rrggbb; empty for that of the page.
        others: Further lines.
    """

    title: str
    x_label: str
    y_label: str
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    dots: Sequence[Dot]
    limit: float | None = None
    limit_label: str = ""
    percent: str = ""
    width: float = 420.0
    height: float = 250.0
    colour: str = ""
    others: Sequence[Series] = ()

    def x(self, value: float) -> float:
        """Return the position of ``value`` in the picture, from the left."""
        low, high = self.x_range
        return LEFT + (value - low) / (high - low) * (self.width - LEFT - RIGHT)

    def y(self, value: float) -> float:
        """Return the position of ``value`` in the picture, from the top, clipped to the plot."""
        low, high = self.y_range
        share = min(1.0, max(0.0, (value - low) / (high - low)))
        return self.height - BOTTOM - share * (self.height - TOP - BOTTOM)


def render_chart(chart: Chart) -> str:
    """Return ``chart`` as an SVG element to embed in a page."""
    series = [Series(chart.dots, chart.colour), *chart.others]
    parts = [
        f'<svg class="chart" viewBox="0 0 {chart.width:g} {chart.height:g}" role="img">',
        f"<title>{escape(chart.title)}</title>",
        *_axes(chart),
        *_limit(chart),
        *(part for each in series for part in _line(chart, each)),
        *(_dot(chart, dot) for each in series for dot in each.dots if not math.isnan(dot.y)),
        "</svg>",
    ]
    return "".join(parts)


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 2.5, 4, 5 times a power of ten that is at least ``value``."""
    if not value > 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    factors = (1.0, 2.0, 2.5, 4.0, 5.0, 10.0)
    return next(factor * power for factor in factors if factor * power >= value * (1 - 1e-9))


def _axes(chart: Chart) -> list[str]:
    left, right = LEFT, chart.width - RIGHT
    bottom = chart.height - BOTTOM

    # Draw ticks and grid of y
    parts = []
    for value in _ticks(chart.y_range):
        y = chart.y(value)
        words = f"{value:.0%}" if "y" in chart.percent else f"{value:g}"
        parts.append(f'<path class="grid" d="M{left:g} {y:.1f}H{right:g}"/>')
        parts.append(
            f'<text class="tick" x="{left - 6:g}" y="{y + 4:.1f}" text-anchor="end">{words}</text>'
        )

    # Draw the ticks of x
    for value in _ticks(chart.x_range):
        words = f"{value:.0%}" if "x" in chart.percent else f"{value:g}"
        parts.append(
            f'<text class="tick" x="{chart.x(value):.1f}" y="{bottom + 16:g}" '
            f'text-anchor="middle">{words}</text>'
        )

    # Draw the axis and labels
    middle = (left + right) / 2
    parts.append(f'<path class="axis" d="M{left:g} {bottom:g}H{right:g}"/>')
    parts.append(
        f'<text x="{middle:g}" y="{chart.height - 6:g}" text-anchor="middle">'
        f"{escape(chart.x_label)}</text>"
    )
    parts.append(
        f'<text transform="translate(15 {(TOP + bottom) / 2:g}) rotate(-90)" '
        f'text-anchor="middle">{escape(chart.y_label)}</text>'
    )
    return parts


def _ticks(limits: tuple[float, float]) -> list[float]:
    """Return about four round values within ``limits``."""
    low, high = limits
    step = round_up((high - low) / 5)
    return [
        round(k * step, 9) for k in range(math.ceil(low / step), math.floor(high / step + 1e-9) + 1)
    ]


def _limit(chart: Chart) -> list[str]:
    if chart.limit is None or not chart.y_range[0] <= chart.limit <= chart.y_range[1]:
        return []
    y, right = chart.y(chart.limit), chart.width - RIGHT
    return [
        f'<path class="limit" d="M{LEFT:g} {y:.1f}H{right:g}"/>',
        f'<text class="tick" x="{right:g}" y="{y - 5:.1f}" text-anchor="end">'
        f"{escape(chart.limit_label)}</text>",
    ]


def _line(chart: Chart, series: Series) -> list[str]:
    known = [dot for dot in series.dots if not math.isnan(dot.y)]
    if len(known) < 2:
        return []
    path = "L".join(f"{chart.x(dot.x):.1f} {chart.y(dot.y):.1f}" for dot in known)
    style = f' style="stroke:{series.colour}"' if series.colour else ""
    return [f'<path class="line" d="M{path}"{style}/>']


def _dot(chart: Chart, dot: Dot) -> str:
    x, y = chart.x(dot.x), chart.y(dot.y)

    # Write tooltip and label, which stands below a dot at the upper edge
    at = y - 9 if y > TOP + 10 else y + 18
    title = f"<title>{escape(dot.title)}</title>" if dot.title else ""
    label = (
        f'<text class="label" x="{x:.1f}" y="{at:.1f}" text-anchor="middle">'
        f"{escape(dot.label)}</text>"
        if dot.label
        else ""
    )

    # Draw a circle or an arrow
    fill = dot.colour if dot.filled else "var(--page)"
    if dot.y > chart.y_range[1]:
        shape = f'<path d="M{x - 5:.1f} {y + 9:.1f}h10l-5 -9z" '
    else:
        shape = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4.5 if dot.filled else 3.5}" '
    return f'<g>{title}{shape}fill="{fill}" stroke="{dot.colour}" stroke-width="1.6"/>{label}</g>'
