"""Checks of configured values; their messages name the option, its bounds and the value."""

from __future__ import annotations

import math

from scan3d_twin.core.errors import ConfigError


def check(condition: bool, message: str) -> None:
    """Raise ``ConfigError`` with ``message`` unless ``condition``."""
    if not condition:
        raise ConfigError(message)


def within(name: str, value: float, low: float, high: float) -> None:
    """Raise ``ConfigError`` unless ``low`` <= ``value`` <= ``high``."""
    check(low <= value <= high, f"{name} must be in [{low:g}, {high:g}], got {value:g}")


def at_least_zero(section: str, **values: float) -> None:
    """Raise ``ConfigError`` unless all ``values`` are finite and not negative."""
    for name, value in values.items():
        check(value >= 0 and math.isfinite(value), f"{section}.{name} must be >= 0, got {value:g}")
