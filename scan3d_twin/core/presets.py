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
        "sweep": {"width": math.radians(90.0), "margin": math.radians(30.0), "turning": "look"},
        "registration": {"engine": "grid", "scope": "sweep"},
        "alignment": {"mode": "loop_closure"},
        "planning": {
            "calibration": 2.67,
            "checks": 6,
            "corner_model": "silhouette",
            "closing": "hidden",
            "quantile": 0.8,
            "lambda": 0.005,
            "gamma": 0.013,
            "drift": 0.030,
        },
    },
}
"""Options by preset, in the shape of a configuration file. ``paper``: Zhang, Yan and Sheng.
``best``: the grid engine on the whole sweep, of which the target alone is modelled, all views
aligned when the contour closes, and the closed-form planner, whose choice must stand six simulated
registrations; one of them may fail, as virtual scans lose some of what narrow faces tell. A sweep's
surface counts to 45 deg from its middle, where lines of .5 deg at a standoff of 1 m are 17 mm apart
on a flat front, less than what counts as covered, and views are added for what gaps hide. The
motion's constants are those of a turn, a drive and a turn by ``benchmarks/motion_error.py`` (0.003,
0.011 and 0.029 for 30 robots), rounded up; a run's own innovations scale them. The calibration is
the conformal factor by ``benchmarks/calibrate_error.py`` on random:1000 to random:1024 (68 steps:
2.67; from the odd seeds alone 3.18, which none of the even ones' 35 steps exceeds)."""

DEFAULT_PRESET = "best"


def preset(name: str) -> Mapping[str, Any]:
    """Return the options of the preset ``name``.

    Raises:
        UnknownNameError: There is no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
