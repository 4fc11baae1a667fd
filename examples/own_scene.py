"""Digitise an object of your own
==============================

Any mesh file will do; this one, a chest with a lid, is made here. It is digitised all round.
"""

import sys
import tempfile
from pathlib import Path

import trimesh

import scan3d_twin as s3d

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp(prefix="scan3d_twin-"))

# %%
# The mesh is in metres; it is put on the floor in front of the robot.

body = trimesh.creation.box((0.50, 0.35, 0.40))
lid = trimesh.creation.box((0.56, 0.41, 0.06))
lid.apply_translation((0.0, 0.0, 0.23))
mesh = folder / "chest.stl"
trimesh.util.concatenate([body, lid]).export(mesh)

# %%
# ``tour`` is ``full`` for an object that stands free and ``front`` for one with its back to a wall.
# Without the limit of three views the robot goes all the way round.

options = {"tour": "full", "max_views": 3}
result = s3d.run_sim(str(mesh), seed=0, options=options, out=folder / "chest")
model = s3d.build_model(result.session)
print(f"{result.report['views']} views, {len(model)} points in the model")
