"""The true surface of a recorded simulated run."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from short_runs import COARSE_OPTIONS

import scan3d_twin as s3d
from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.recording.load import load_session
from scan3d_twin.sim.scenes.surface_samples import sample_triangles
from scan3d_twin.viz.true_scene import true_triangles


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A recorded run of one view."""
    folder = tmp_path_factory.mktemp("true_scene") / "run"
    s3d.run_sim("three_boxes", seed=1000, options={"max_views": 1, **COARSE_OPTIONS}, out=folder)
    return load_session(folder)


def test_the_true_surface_lies_on_the_model(run):
    triangles = true_triangles(run)
    assert triangles.shape == (36, 3, 3)
    points, _ = sample_triangles(triangles, 0.005)
    off, _ = cKDTree(points).query(build_model(run.session).points)
    assert np.median(off) < 0.010  # range noise of the lidar


def test_a_scene_that_is_gone_is_an_error_that_says_so(run):
    lost = replace(run.settings, run=replace(run.settings.run, scene="gone.xml"))
    with pytest.raises(TwinError, match="gone"):
        true_triangles(replace(run, settings=lost))
