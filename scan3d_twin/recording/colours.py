"""The colours of the views, the same in every picture, page and file."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.types import IntArray

VIEW_COLOURS = (
    "#2f7ed8", "#e8710a", "#1f9d55", "#d6336c", "#8250df",
    "#b08800", "#0c8599", "#c2410c", "#5f7d1f", "#a61e9b",
)  # fmt: skip
"""Colours of views 0 to 9, then repeated; of medium lightness, legible on white and on black."""
GREY = (150, 150, 150)
"""Colour of what belongs to no single view, or not to the target."""


def view_colour(view: int) -> str:
    """Return the colour of ``view`` as #rrggbb."""
    return VIEW_COLOURS[view % len(VIEW_COLOURS)]


def view_colours_rgb(views: IntArray) -> npt.NDArray[np.uint8]:
    """Return the colours (n, 3) of ``views`` (n,), 0..255."""
    table = [[int(name[i : i + 2], 16) for i in (1, 3, 5)] for name in VIEW_COLOURS]
    return np.array(table, dtype=np.uint8)[views % len(VIEW_COLOURS)]


def pack_rgb(colours: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Return ``colours`` (n, 3) in the bits 0xRRGGBB of floats (n,), as PCL and ROS have them."""
    red, green, blue = colours.astype(np.uint32).T
    return np.asarray((red << 16 | green << 8 | blue).view(np.float32))
