"""Test helper: error codes, repeats and mixed pixels in lines of the twin or a real sensor."""

import math
from dataclasses import dataclass

import numpy as np

JUMP_MM = 150
"""Depth edges between the two neighbours of a step."""
MARGIN_MM = 10
"""A mixed pixel lies between its neighbours by more than the noise."""


@dataclass(frozen=True)
class Share:
    """``count`` of ``total``."""

    count: int
    total: int

    @property
    def value(self) -> float:
        """The share, 0..1; 0 without a total."""
        return self.count / max(1, self.total)

    def interval(self, z: float = 1.96) -> tuple[float, float]:
        """Return the 95 % interval (Wilson 1927)."""
        n, p = max(1, self.total), self.value
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
        return max(0.0, centre - half), min(1.0, centre + half)


def statistics(millimetres: np.ndarray) -> dict[str, Share]:
    """Return shares of lines (m, n): distances [mm] or codes below 20."""
    valid = millimetres >= 20
    pairs = valid[:, 1:] & valid[:, :-1]
    equal = pairs & (millimetres[:, 1:] == millimetres[:, :-1])
    left, middle, right = millimetres[:, :-2], millimetres[:, 1:-1], millimetres[:, 2:]
    triples = valid[:, :-2] & valid[:, 1:-1] & valid[:, 2:]
    low, high = np.minimum(left, right) + MARGIN_MM, np.maximum(left, right) - MARGIN_MM
    mixed = triples & (np.abs(right - left) > JUMP_MM) & (low < middle) & (middle < high)
    runs = np.zeros_like(valid)
    threes = equal[:, 1:] & equal[:, :-1]
    for shift in range(3):
        runs[:, shift : shift + threes.shape[1]] |= threes
    shares = {f"code {code}": Share(int((millimetres == code).sum()), valid.size) for code in CODES}
    return {
        "invalid": Share(int((~valid).sum()), valid.size),
        **shares,
        "equal neighbours": Share(int(equal.sum()), int(pairs.sum())),
        "in runs of 3 or more": Share(int((runs & valid).sum()), int(valid.sum())),
        "mixed pixels": Share(int(mixed.sum()), int(valid.sum())),
    }


CODES = (0, 2, 6, 7, 8, 10, 18)
