"""Digitise three boxes
====================

The scene of the paper's second experiment, all that ``twin sim`` does in one call. The folder holds
the model, the recording, the report and the picture below.
"""

import sys
import tempfile
from pathlib import Path

import scan3d_twin as s3d

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="scan3d_twin-"))

# %%
# ``options`` are nested as in a configuration file. Here they limit the number of views, to be
# quick.

result = s3d.run_sim("three_boxes", seed=0, options={"max_views": 4}, out=folder / "three_boxes")
print(f"{result.report['views']} views: {result.session.stop_reason}")
print(f"{result.report['coverage_20mm']:.0%} of the coverable surface is within 20 mm of the model")

# %%
# Where each view was taken, and how long a step the planner dared to take from there.

for k, (view, plan) in enumerate(zip(result.session.views, result.session.plans, strict=True)):
    here = view.T_world_scan
    print(f"view {k} from ({here.x:+.2f}, {here.y:+.2f}) m: {len(view.target)} points")
    print(f"    {plan.overlap:.0%} overlap: {plan.reason}")

# %%
# The session can be read again at any time, and its model written for other programs.

session = s3d.load_session(folder / "three_boxes")
print(*s3d.export_model(session, folder / "three_boxes.xyz", "xyz", voxel=0.01))
