"""The room around a mesh, as a text that states its size."""

from __future__ import annotations

import math

from scan3d_twin.core.errors import ConfigError

DEFAULT_ROOM = "5x5"
"""Room around a mesh: width by depth [m]; that of a living room, within reach of the lidar."""
NO_ROOM = "none"
"""Name of the open floor, without walls."""
SIZE_LIMITS = (1.0, 50.0)
"""Smallest and largest width or depth of a room [m]; beyond, its unit is wrong."""


def parse_room(text: str) -> tuple[float, float] | None:
    """Return width and depth of the room [m] that ``text`` states as WxD; None for none.

    Raises:
        ConfigError: ``text`` is neither ``none`` nor two numbers within ``SIZE_LIMITS``.
    """
    if text == NO_ROOM:
        return None
    low, high = SIZE_LIMITS
    try:
        width, depth = (float(part) for part in text.split("x"))
    except ValueError:
        width = depth = math.nan
    if not (low <= width <= high and low <= depth <= high):
        raise ConfigError(
            f"room must be WIDTHxDEPTH with {low:g} to {high:g} m each, such as {DEFAULT_ROOM}, or "
            f"{NO_ROOM}; got {text!r}"
        )
    return width, depth
