"""The table of an experiment for the terminal: blocks of columns that are no wider than it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

GAP = 2
"""Blanks between columns."""
NAME_SHARE = 0.4
"""Largest share of a line that the names of the variants take; longer ones are cut."""


def fold_table(cells: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return a table as lines of at most ``width`` letters.

    The measures are spread over as many blocks as they need, each with the names of the variants
    in front. A scene is named once, above its rows.

    Args:
        cells: A heading and rows: scene, variant, number of runs, and the measures.
        width: Letters of a line.
    """
    heading, *rows = cells
    lines: list[str] = []
    for scene, group in groupby(rows, key=lambda row: row[0]):
        table = [heading[1:], *(row[1:] for row in group)]
        lines += [_cut(scene, width), *_fold_scene(table, width), ""]
    return lines[:-1]


def _fold_scene(table: Sequence[Sequence[str]], width: int) -> list[str]:
    """Return the blocks of one scene, a blank line between them."""
    # Measure the columns
    most = int(NAME_SHARE * width)
    names = [_cut(row[0], most) for row in table]
    first = max(map(len, names))
    widths = [max(len(row[i]) for row in table) for i in range(1, len(table[0]))]

    # Fill one block after the other
    lines: list[str] = []
    for block in _split(widths, width - first - GAP):
        if lines:
            lines.append("")
        for name, row in zip(names, table, strict=True):
            padded = [f"{name:<{first}}", *(f"{row[i + 1]:<{widths[i]}}" for i in block)]
            lines.append((" " * GAP).join(padded).rstrip())
    return lines


def _split(widths: Sequence[int], room: int) -> list[list[int]]:
    """Return the columns in blocks, each of at least one column and else no wider than ``room``."""
    blocks: list[list[int]] = []
    left = -1
    for i, wide in enumerate(widths):
        if left < wide:
            blocks.append([])
            left = room
        blocks[-1].append(i)
        left -= wide + GAP
    return blocks


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "\N{HORIZONTAL ELLIPSIS}"
