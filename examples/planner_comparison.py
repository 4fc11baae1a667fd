"""Compare planners
================

Two fixed overlaps against the planner of the preset ``best``, on the same robot with the
same noise. ``twin bench`` does this for hundreds of runs, with intervals and tests.
"""

import sys
import tempfile
from pathlib import Path

import scan3d_twin as s3d

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="scan3d_twin-"))

# %%
# A planner is part of the configuration; ``scan3d_twin.list_planners()`` lists them.

for planner in ("fixed20", "fixed80", s3d.Config().planner):
    options = {"planner": planner, "max_views": 2}
    result = s3d.run_sim("sine_box", seed=0, options=options, out=folder / planner)
    report = result.report
    errors = [step["error_mm"] for step in report["registration"]]
    print(f"{planner:8} {report['coverage_20mm']:4.0%} covered, {report['points']} points")
    print(f"         {report['views']} views, worst registration error {max(errors):.1f} mm")

# %%
# On this wavy surface the planner finds the smallest overlap accurate enough. It shows more with
# each view; a large overlap is safer where a surface has few features.
