"""The colours of the points on the live page: by view, or by height."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.types import FloatArray
from scan3d_twin.recording.colours import view_colours_rgb

Colouring = Literal["view", "height"]
COLOURINGS: tuple[Colouring, ...] = ("view", "height")
RAMP = np.array([[0.19, 0.32, 0.75], [0.12, 0.66, 0.55], [0.98, 0.78, 0.22]])
"""Colours from low to high, 0..1; those of the report's page."""


def colour_points(
    points: FloatArray, view: int, colouring: Colouring, heights: tuple[float, float]
) -> npt.NDArray[np.uint8]:
    """Return the colours of the ``points`` (n, 3) [m] of ``view``: (3,) if all are the same.

    Args:
        points: The points; their z is the height.
        view: Number of the view.
        colouring: What decides.
        heights: Lowest and highest height of the colours [m].
    """
    if colouring == "view":
        return np.array(view_colours_rgb(np.array([view]))[0])
    low, high = heights
    share = np.clip((points[:, 2] - low) / max(1e-3, high - low), 0.0, 1.0)
    places = np.linspace(0.0, 1.0, len(RAMP))
    ramp = np.stack([np.interp(share, places, RAMP[:, k]) for k in range(3)], axis=1)
    return np.array(np.round(255 * ramp), dtype=np.uint8)
