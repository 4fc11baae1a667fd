"""Presets: named sets of options that override the defaults and yield to the user's own options."""

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
"""Options by preset, in the shape of a configuration file.

``paper``: the method as published by Zhang, Yan and Sheng.

``best``: the grid engine registers whole sweeps, of which only the target is modelled; loop closure
aligns all views; the closed-form planner decides, and six simulated registrations check its choice.
One of the six may fail, as virtual scans lose some information of narrow faces. Views are added for
surface hidden in gaps. Where the numbers come from:

* width: surface counts to 45 deg from the middle of a sweep, where lines of 0.5 deg at a standoff
  of 1 m are 17 mm apart on a flat front, closer than the 20 mm within which surface is covered;
* lambda, gamma, drift: the errors of a turn, a drive and a turn by ``benchmarks/motion_error.py``
  (0.003, 0.011 and 0.029 for 30 robots), rounded up; the innovations of a run scale them;
* calibration: the conformal factor by ``benchmarks/calibrate_error.py`` on random:1000 to
  random:1024 (68 steps: 2.67; from the odd seeds alone 3.18, which none of the 35 steps of the even
  seeds exceeds).
"""

DEFAULT_PRESET = "best"


def preset(name: str) -> Mapping[str, Any]:
    """Return the options of the preset ``name``, in the shape of a configuration file.

    Raises:
        UnknownNameError: There is no such preset; the message lists them.
    """
    if name not in PRESETS:
        raise UnknownNameError("preset", name, PRESETS)
    return PRESETS[name]
