"""Loading of what other packages offer by entry points: planners, export formats, devices.

Importing this module costs nothing (no numpy), so that help pages can list the names.
"""

from __future__ import annotations

from pkgutil import resolve_name
from typing import Any

from scan3d_twin.core.errors import ConfigError


class PluginError(ConfigError):
    """What another package offers cannot be used.

    Attributes:
        reason: Why, in one line.
    """

    def __init__(self, kind: str, name: str, place: str, reason: object) -> None:
        if isinstance(reason, Exception):
            reason = f"{type(reason).__name__}: {reason}"
        self.reason = " ".join(str(reason).split())
        super().__init__(f"{kind} {name} ({place}) cannot be loaded: {self.reason}")


def load_plugin(kind: str, name: str, place: str) -> Any:
    """Return the object at ``place``, such as ``package.module:attribute``.

    Args:
        kind: What it is, for messages.
        name: By which it is chosen.
        place: Value of its entry point.

    Raises:
        PluginError: Importing it fails, for whatever reason.
    """
    try:
        return resolve_name(place)
    except Exception as error:
        raise PluginError(kind, name, place, error) from error
