"""Named sets of options; a preset lies between the defaults and everything the user states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scan3d_twin.core.errors import UnknownNameError

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "paper": {"planner": "siicp"},
}
"""Options by preset, in the shape of a configuration file. ``paper``: Zhang, Yan and Sheng."""

DEFAULT_PRESET = "paper"


def preset(name: str) -> Mapping[str, Any]:
    """Return the options of the preset ``name``.

    Raises:
        UnknownNameError: There is no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
