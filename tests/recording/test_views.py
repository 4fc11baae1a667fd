import io
from pathlib import Path

import numpy as np

from scan3d_twin.recording.views import view_bytes, view_path


def test_views_are_numbered_as_in_the_report():
    assert view_path(Path("run"), 7) == Path("run/views/007.npz")


def test_a_view_keeps_what_was_measured_and_where(session):
    view = session.views[1]
    with np.load(io.BytesIO(view_bytes(view))) as saved:
        image = view.observation.image
        np.testing.assert_array_equal(saved["ranges"], image.ranges)
        np.testing.assert_array_equal(saved["yaws"], image.yaws)
        np.testing.assert_array_equal(saved["codes"], image.codes)
        np.testing.assert_array_equal(saved["stamps"], image.stamps)
        np.testing.assert_array_equal(saved["target_points"], view.target.points)
        pose = view.T_world_scan
        np.testing.assert_array_equal(saved["T_world_scan"], [pose.x, pose.y, pose.yaw])
        pose = view.observation.T_odom_scan
        np.testing.assert_array_equal(saved["T_odom_scan"], [pose.x, pose.y, pose.yaw])


def test_equal_views_give_equal_bytes(session):
    assert view_bytes(session.views[0]) == view_bytes(session.views[0])
    assert view_bytes(session.views[0]) != view_bytes(session.views[1])
