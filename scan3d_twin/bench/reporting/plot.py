"""Plots of many runs as SVG: dots, lines with bands, bars with intervals. No fonts, no scripts.

A dot can be a link. An invisible rim makes it as large as a finger needs (WCAG 2.5.8).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape

from scan3d_twin.bench.reporting.statistics import Estimate
from scan3d_twin.recording.colours import VIEW_COLOURS

LEFT, RIGHT, TOP, BOTTOM = 62.0, 14.0, 34.0, 46.0
"""Margins of the plot [units of the picture]."""
LEGEND_LINE = 20.0
LETTER = 7.0
"""Width that a letter takes on the average, rounded up [units of the picture]."""
MAX_LINKED_DOTS = 400
"""Most dots of a plot that are links: more of them cover each other, and make pages heavy."""
MAX_LOG_TICKS = 8
STYLE = """
.pl { font: 13px system-ui, "Helvetica Neue", Arial, sans-serif; background: #ffffff; }
.pl text { fill: #1f2328; } .pl .title { font-size: 14px; font-weight: 600; }
.pl .tick { fill: #57606a; } .pl .grid { stroke: #d8dee4; } .pl .axis { stroke: #57606a; }
.pl .limit { stroke: #57606a; stroke-dasharray: 6 4; } .pl .line { fill: none; stroke-width: 2; }
.pl a circle { stroke: transparent; stroke-width: 18; pointer-events: all; cursor: pointer; }
.pl a:focus { outline: none; } .pl a:focus circle, .pl a.near circle {
stroke: #1f2328; stroke-width: 2; fill-opacity: 1; }
@media (prefers-color-scheme: dark) {
.pl { background: #0d1117; } .pl text { fill: #f0f6fc; } .pl .tick { fill: #9198a1; }
.pl .grid { stroke: #262c36; } .pl .axis, .pl .limit { stroke: #9198a1; }
.pl a:focus circle, .pl a.near circle { stroke: #f0f6fc; }
}
@media print {
.pl { background: #ffffff; } .pl text, .pl .tick { fill: #000000; }
.pl .grid { stroke: #cccccc; } .pl .axis, .pl .limit { stroke: #444444; }
}"""


@dataclass(frozen=True, slots=True)
class Dot:
    """A dot of a plot at (x, y); ``title`` says what it is, ``href`` where it leads to."""

    x: float
    y: float
    title: str = ""
    href: str = ""


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis from ``low`` to ``high``.

    Attributes:
        label: Text beside it.
        low, high: Its ends.
        log: Whether it is logarithmic.
        form: Format of a tick label.
        step: Smallest step between ticks: 1 where only whole numbers make sense.
    """

    label: str
    low: float
    high: float
    log: bool = False
    form: str = "{:g}"
    step: float = 0.0

    def share(self, value: float) -> float:
        """Return the position of ``value`` along the axis, clipped to 0..1."""
        if self.log:
            low, high = math.log(self.low), math.log(self.high)
            value = math.log(max(value, self.low))
        else:
            low, high = self.low, self.high
        return min(1.0, max(0.0, (value - low) / (high - low)))

    def ticks(self) -> list[float]:
        """Return about five round values."""
        if self.log:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            values = [m * 10.0**p for p in powers for m in (1, 2, 5)]
            if sum(self.low <= v <= self.high for v in values) > MAX_LOG_TICKS:
                values = [10.0**p for p in powers]
        else:
            step = max(self.step, _round_step((self.high - self.low) / 5))
            first = math.ceil(self.low / step - 1e-9)
            values = [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]
        slack = 1e-9 * abs(self.high)
        return [round(v, 12) for v in values if self.low - slack <= v <= self.high + slack]


def axis_over(label: str, values: Iterable[float], *, log: bool = False, step: float = 0.0) -> Axis:
    """Return an axis that spans all finite ``values`` with a margin."""
    known = [value for value in values if math.isfinite(value) and (value > 0 or not log)]
    if not known:
        return Axis(label, 1.0, 10.0, log) if log else Axis(label, 0.0, 1.0, step=step)
    low, high = min(known), max(known)
    if log:
        return Axis(label, low / 1.3, high * 1.3, log=True)
    high = max(high, low + 1e-9)
    low = 0.0 if 0 <= low < 0.7 * high else low - 0.05 * (high - low)
    return Axis(label, low, high + 0.05 * (high - low), step=step)


def share_axis(label: str) -> Axis:
    """Return an axis from 0 to 100 %."""
    return Axis(label, 0.0, 1.0, form="{:.0%}")


@dataclass
class Plot:
    """A plot to which dots, lines, bands and bars are added.

    Attributes:
        title: Text above it.
        x: Horizontal axis.
        y: Vertical axis.
        width: Width [units of the picture].
        height: Height without the legend [units of the picture].
    """

    title: str
    x: Axis
    y: Axis
    width: float = 400.0
    height: float = 300.0
    _linked: int = 0
    _parts: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str]] = field(default_factory=list)

    def position_of(self, x: float, y: float) -> tuple[float, float]:
        """Return the position of (x, y) in the picture."""
        wide, high = self.width - LEFT - RIGHT, self.height - TOP - BOTTOM
        return LEFT + wide * self.x.share(x), self.height - BOTTOM - high * self.y.share(y)

    def add_legend(self, label: str, colour: str) -> None:
        """Add an entry to the legend."""
        if (label, colour) not in self._legend:
            self._legend.append((label, colour))

    def add_dots(self, dots: Iterable[Dot], colour: str, size: float = 3.5) -> None:
        """Draw each of ``dots`` that is finite; the first ``MAX_LINKED_DOTS`` become links."""
        self._parts.append(f'<g fill="{colour}" fill-opacity="0.55">')
        for dot in dots:
            if math.isfinite(dot.x) and math.isfinite(dot.y):
                px, py = self.position_of(dot.x, dot.y)
                circle = f'<circle cx="{px:.1f}" cy="{py:.1f}" r="{size:g}"/>'
                self._parts.append(self._link(dot, circle))
        self._parts.append("</g>")

    def _link(self, dot: Dot, circle: str) -> str:
        """Return ``circle`` as a link, if ``dot`` leads somewhere."""
        if not dot.href or self._linked >= MAX_LINKED_DOTS:
            return circle
        self._linked += 1
        title = escape(dot.title)
        href = escape(dot.href, {'"': "&quot;"})
        return f'<a href="{href}"><title>{title}</title>{circle}</a>'

    def add_line(self, points: Iterable[tuple[float, float]], colour: str) -> None:
        """Join ``points``."""
        path = "L".join(
            f"{x:.1f} {y:.1f}" for x, y in (self.position_of(*point) for point in points)
        )
        if path:
            self._parts.append(f'<path class="line" d="M{path}" stroke="{colour}"/>')

    def add_band(self, rows: Sequence[tuple[float, Estimate]], colour: str) -> None:
        """Draw a line through values by x and a band through their intervals."""
        known = [(x, e) for x, e in rows if e.has_interval]
        upper = [self.position_of(x, e.high) for x, e in known]
        lower = [self.position_of(x, e.low) for x, e in reversed(known)]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in upper + lower)
        if corners:
            self._parts.append(f'<polygon points="{corners}" fill="{colour}" fill-opacity="0.15"/>')
        self.add_line([(x, e.value) for x, e in rows if e.n], colour)

    def add_bar(self, x: float, half: float, estimate: Estimate, colour: str) -> None:
        """Draw a bar from the axis to a value, with its interval as a whisker."""
        if estimate.n == 0:
            return
        (left, top), (right, bottom) = (
            self.position_of(x - half, estimate.value),
            self.position_of(x + half, 0),
        )
        self._parts.append(
            f'<rect x="{left:.1f}" y="{top:.1f}" width="{right - left:.1f}" '
            f'height="{bottom - top:.1f}" fill="{colour}" fill-opacity="0.75"/>'
        )
        self.add_whisker(x, estimate)

    def add_whisker(self, x: float, estimate: Estimate) -> None:
        """Draw an interval, if there is one."""
        if not estimate.has_interval:
            return
        px, low = self.position_of(x, estimate.low)
        high = self.position_of(x, estimate.high)[1]
        self._parts.append(
            f'<path class="axis" d="M{px:.1f} {low:.1f}V{high:.1f}M{px - 4:.1f} {low:.1f}h8'
            f'M{px - 4:.1f} {high:.1f}h8"/>'
        )

    def add_limit(self, y: float, label: str) -> None:
        """Draw a dashed line across."""
        px, py = self.position_of(self.x.high, y)
        self._parts.append(f'<path class="limit" d="M{LEFT:g} {py:.1f}H{px:.1f}"/>')
        self._parts.append(
            f'<text class="tick" x="{px - 3:.1f}" y="{py - 5:.1f}" text-anchor="end">'
            f"{escape(label)}</text>"
        )

    def add_diagonal(self) -> None:
        """Draw y = x, dashed."""
        low, high = max(self.x.low, self.y.low), min(self.x.high, self.y.high)
        (ax, ay), (bx, by) = self.position_of(low, low), self.position_of(high, high)
        self._parts.append(f'<path class="limit" d="M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}"/>')

    def render(self) -> str:
        """Return the plot as an SVG document that can also be embedded in a page."""
        total = self.height + LEGEND_LINE * math.ceil(len(self._legend) / self._legend_columns())
        role = "group" if self._linked else "img"
        name = escape(self.title, {'"': "&quot;"})
        return "\n".join(
            [
                f'<svg xmlns="http://www.w3.org/2000/svg" class="pl" role="{role}" '
                f'aria-label="{name}" viewBox="0 0 {self.width:g} {total:g}">',
                f"<title>{escape(self.title)}</title><style>{STYLE}</style>",
                f'<text class="title" x="{self.width / 2:g}" y="20" text-anchor="middle">'
                f"{escape(_shorten(self.title, self.width))}</text>",
                *self._axes(),
                *self._parts,
                *self._legend_parts(),
                "</svg>\n",
            ]
        )

    def _axes(self) -> list[str]:
        bottom, right = self.height - BOTTOM, self.width - RIGHT

        # Draw ticks and grid of y
        parts = []
        for value in self.y.ticks():
            y = self.position_of(self.x.low, value)[1]
            words = self.y.form.format(value)
            parts.append(f'<path class="grid" d="M{LEFT:g} {y:.1f}H{right:g}"/>')
            parts.append(
                f'<text class="tick" x="{LEFT - 6:g}" y="{y + 4:.1f}" text-anchor="end">'
                f"{words}</text>"
            )

        # Draw the ticks of x
        for value in self.x.ticks() if self.x.label else ():
            x = self.position_of(value, self.y.low)[0]
            words = self.x.form.format(value)
            parts.append(
                f'<text class="tick" x="{x:.1f}" y="{bottom + 16:g}" text-anchor="middle">'
                f"{words}</text>"
            )

        # Draw the axis and labels
        middle = (TOP + bottom) / 2
        return [
            *parts,
            f'<path class="axis" d="M{LEFT:g} {bottom:g}H{right:g}"/>',
            f'<text x="{(LEFT + right) / 2:g}" y="{bottom + 36:g}" text-anchor="middle">'
            f"{escape(self.x.label)}</text>",
            f'<text transform="translate(14 {middle:g}) rotate(-90)" text-anchor="middle">'
            f"{escape(self.y.label)}</text>",
        ]

    def _legend_columns(self) -> int:
        """Return the number of columns of the legend: two where its labels are short."""
        longest = max((len(label) for label, _ in self._legend), default=0)
        return 2 if 17 + LETTER * longest < (self.width - RIGHT) / 2 else 1

    def _legend_parts(self) -> list[str]:
        parts, columns = [], self._legend_columns()
        wide = (self.width - RIGHT) / columns
        for k, (label, colour) in enumerate(self._legend):
            x, y = RIGHT + wide * (k % columns), self.height + LEGEND_LINE * (k // columns)
            parts.append(
                f'<rect x="{x:g}" y="{y:g}" width="11" height="11" rx="2" fill="{colour}"/>'
                f'<text x="{x + 17:g}" y="{y + 10:g}"><title>{escape(label)}</title>'
                f"{escape(_shorten(label, wide - 17))}</text>"
            )
        return parts


def assign_colours(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each name, the same in all plots of a report."""
    return {name: VIEW_COLOURS[k % len(VIEW_COLOURS)] for k, name in enumerate(names)}


def _shorten(text: str, width: float) -> str:
    """Return ``text``, cut where it is wider than ``width`` [units of the picture]."""
    most = int(width / LETTER)
    return text if len(text) <= most else text[: most - 1] + "\N{HORIZONTAL ELLIPSIS}"


def _round_step(length: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is at least ``length``."""
    power = 10.0 ** math.floor(math.log10(length))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= length * (1 - 1e-9))
