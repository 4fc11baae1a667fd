"""A figure of a report, and the kinds of them."""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.bench.record import Record

Cells = list[list[str | float | int | None]]
TITLES = {
    "pareto": "Views and errors",
    "coverage": "Coverage",
    "calibration": "Predicted and realised errors",
    "overlap": "Overlaps and features",
    "lambda": "The error the planner assumes",
    "success": "Variants side by side",
}
"""Kinds of figures with their titles, in the order of the report."""


@dataclass(frozen=True)
class Figure:
    """A figure with its caption and its numbers.

    Attributes:
        kind: What it shows: a key of ``TITLES``.
        name: Name of its files.
        caption: Text below it.
        svg: The picture.
        rows: Its numbers, with a heading.
    """

    kind: str
    name: str
    caption: str
    svg: str
    rows: Cells


Group = dict[str, list[Record]]
"""Runs of one scene by variant."""
