"""Limits on files from elsewhere: how large they may be, and what they may expand to.

A file that exceeds one is refused in one line before memory or time is spent on it. The environment
variable ``TWIN_FILE_LIMITS`` multiplies all limits: 4 admits four times as much.
"""

from __future__ import annotations

import math
import os

VARIABLE = "TWIN_FILE_LIMITS"
FREE_EXPANSION, EXPANSION = 64 * 1024 * 1024, 32
"""What a compressed file may expand to: this many bytes, and so many times its size. Sessions and
sweeps expand two- to fivefold."""


def limit_factor() -> float:
    """Return the factor on all limits that the environment asks for; 1 where it is no number."""
    try:
        factor = float(os.environ.get(VARIABLE, "1"))
    except ValueError:
        return 1.0
    return factor if math.isfinite(factor) and factor > 0 else 1.0


def scaled(limit: int) -> int:
    """Return ``limit`` times the factor of the environment."""
    return int(limit * limit_factor())


def how_to_raise() -> str:
    """Return the end of a message about a limit: how a trusted file gets through."""
    return f"if you trust it, set {VARIABLE}={4 * limit_factor():g}"


def expansion_limit(size: int) -> int:
    """Return what a compressed file of ``size`` bytes may expand to [bytes]."""
    return scaled(FREE_EXPANSION + EXPANSION * size)
