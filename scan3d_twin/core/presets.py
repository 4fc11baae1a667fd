"""Named sets of options; a preset lies between the defaults and everything the user states."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from scan3d_twin.core.errors import UnknownNameError

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "paper": {"planner": "siicp"},
    "best": {
        "planner": "fisher",
        "sweep": {"margin": math.radians(45.0)},
        "registration": {"engine": "grid", "scope": "sweep"},
        "alignment": {"when": "closed"},
        "planning": {"calibration": 3.0},
    },
}
"""Options by preset, in the shape of a configuration file. ``paper``: Zhang, Yan and Sheng.
``best``: the grid engine on the whole sweep, of which the target alone is modelled, all views
aligned when the contour closes, and the closed-form planner; its calibration is a first value from
closed loops on three_boxes, where the realised errors were 0.5 to 4 times the predicted ones, not
yet a fit."""

DEFAULT_PRESET = "paper"


def preset(name: str) -> Mapping[str, Any]:
    """Return the options of the preset ``name``.

    Raises:
        UnknownNameError: There is no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
