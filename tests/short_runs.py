"""Test helper: options of `twin sim` for a run that takes little time."""

COARSE = ("--sweep.yaw-rate", "0.5", "--sweep.look-rate", "1.2")
"""Sweeps of some 55 lines instead of 230, for tests of what is done with a run."""
COARSE_OPTIONS = {"sweep": {"yaw_rate": 0.5, "look_rate": 1.2}}
"""The same as options of ``run_sim``."""
TWO_VIEWS = ("sim", "--scene", "three_boxes", "--max-views", "2", "--epsilon", "100", *COARSE)
"""Two views of the three boxes; of the wanted accuracy, 100 mm, nothing can be short."""
ONE_VIEW = ("sim", "--scene", "three_boxes", "--max-views", "1", *COARSE)
