"""The median of a few thousand numbers, without what ``np.median`` spends on axes and NaN."""

from __future__ import annotations

import numpy as np

from scan3d_twin.core.types import FloatArray


def median(values: FloatArray) -> float:
    """Return the median of ``values`` (n,), all finite; the same number as ``np.median`` gives."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    part = np.partition(values, high) if low == high else np.partition(values, (low, high))
    return float(part[low] + part[high]) / 2
