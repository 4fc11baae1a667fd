"""The preset ``paper``: what differs from the defaults, which are the preset ``best``.

``best`` registers surfels on the grid of the whole sweep, of which the target alone is modelled;
aligns all views on loop closure; and plans in closed form, with a choice that must stand six
simulated registrations, of which one may fail, because virtual scans lose some of what narrow faces
determine. A sweep's surface counts to 45 deg from its middle, where lines of 0.5 deg at a standoff
of 1 m are 17 mm apart on a flat front, less than what counts as covered, and views are added for
what gaps hide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

DEFAULT_PRESET = "best"
PRESETS = (DEFAULT_PRESET, "paper")
"""Names of the presets."""

PAPER: Mapping[str, Any] = {
    "planner": "siicp",
    "sweep": {"width": math.radians(60.0), "margin": 0.0, "turning": "odometry"},
    "registration": {"engine": "icp", "scope": "target"},
    "alignment": {"mode": "off"},
    "planning": {
        "calibration": 1.0,
        "checks": 0,
        "corner_model": "contour",
        "fallback": "default",
        "sector": "whole",
        "standoff_rule": "fixed",
        "closing": "none",
        "quantile": 0.9,
        "lambda": 0.030,
        "gamma": 0.026,
        "drift": 0.036,
        "motion_variation": 1.0,
    },
}
"""Options by section, in the shape of a configuration file: Zhang, Yan and Sheng. A sweep of 60 deg
sees 1.15 m at the standoff of 1 m; lambda, gamma and drift are fitted to plain odometry by
``benchmarks/motion_error.py``, the drift being 2.07 deg/m."""
