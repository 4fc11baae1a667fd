"""Arrays and what is often done with them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
SmallIntArray = npt.NDArray[np.int32]
BoolArray = npt.NDArray[np.bool_]


def wrap(angle: float) -> float:
    """Return ``angle`` [rad] wrapped to [-pi, pi); angles in that range keep their exact value."""
    if -math.pi <= angle < math.pi:
        return angle
    return (angle + math.pi) % math.tau - math.pi


def wrap_all(angles: FloatArray) -> FloatArray:
    """Return ``angles`` (n,) [rad], each as ``wrap`` returns it."""
    inside = (angles >= -math.pi) & (angles < math.pi)
    return np.where(inside, angles, (angles + math.pi) % math.tau - math.pi)


def rms(vectors: FloatArray) -> float:
    """Return the root mean square length of ``vectors`` (n, k); 0 for none."""
    return float(np.sqrt(np.sum(vectors**2) / max(1, len(vectors))))


def read_only(array: npt.ArrayLike, dtype: Any = np.float64) -> npt.NDArray[Any]:
    """Return ``array`` as a contiguous, read-only array; writable input is copied."""
    result = np.ascontiguousarray(array, dtype=dtype)
    if result.flags.writeable:
        result = result.copy()
        result.flags.writeable = False
    return result
