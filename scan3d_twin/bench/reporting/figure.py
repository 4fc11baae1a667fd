"""A figure of a report, and the kinds of them."""

from __future__ import annotations

import re
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
        name: Name of it, which may hold that of any scene.
        caption: Text below it.
        svg: The picture.
        rows: Its numbers, with a heading.
    """

    kind: str
    name: str
    caption: str
    svg: str
    rows: Cells

    @property
    def file_name(self) -> str:
        """Name of its files."""
        return in_file_name(self.name)


def in_file_name(text: str) -> str:
    """Return ``text`` as a part of a file's name; results may name any scene."""
    return re.sub(r"[^\w.-]", "_", text)


Group = dict[str, list[Record]]
"""Runs of one scene by variant."""
