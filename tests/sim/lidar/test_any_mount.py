"""A lidar that is mounted in any direction: the twin, the point formula and the loop agree."""

import math
from dataclasses import replace

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.core.config import MountConfig, SweepConfig
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.scanning.upright import is_upright

NARROW = SweepConfig(width=math.radians(60.0), margin=0.0)


def mounted(yaw, pitch, roll, pattern="yaw-base"):
    """Return a twin with a lidar that is turned so."""
    yaw, pitch, roll = np.radians([yaw, pitch, roll]).tolist()
    turns = {"lidar_yaw": yaw, "lidar_pitch": pitch, "lidar_roll": roll}
    return replace(s3d.TwinConfig.ideal(), pattern=pattern, turntable="ideal", **turns)


@pytest.mark.parametrize(
    "turns", [(0, 0, 90), (0, -90, 0), (60, 20, -35), (25, -20, 30, "yaw"), (0, 0, 40, "pitch")]
)
def test_points_are_where_the_scene_is(turns):
    with s3d.open_sim("three_boxes", 1000, mounted(*turns)) as (robot, truth):
        image = sweep(robot, 0.0, s3d.Config(sweep=NARROW), lambda _: None).image
        middle = len(image.stamps) // 2
        pose = truth.pose_at(float(image.stamps[middle]))
        line, beam = (part[::100] for part in np.nonzero(image.ranges > 0.5))
        rays, ranges = image.directions[line, beam], image.ranges[line, beam]
        origins = image.points[line, beam] - ranges[:, None] * rays
        seen = truth.first_hits(pose.apply(origins), pose.rotate(rays))
    assert not is_upright(image)
    assert len(ranges) > 100
    assert np.median(np.abs(seen - ranges)) < 0.004


def test_what_the_robot_does_not_know_can_be_stated():
    """Errors that a user states in ``config.mount`` are as good as a mount that is known."""
    twin, errors = s3d.TwinConfig.ideal(), {"mount_roll": 0.1, "mount_pitch": -0.15}
    twin = replace(twin, errors=replace(twin.errors, **errors))
    stated = s3d.Config(sweep=NARROW, mount=MountConfig(roll=0.1, pitch=-0.15))
    with s3d.open_sim("three_boxes", 1000, twin) as (robot, _):
        image = sweep(robot, 0.0, stated, lambda _: None).image
    floor = image.heights[np.abs(image.heights) < 0.02]
    assert np.median(np.abs(floor)) < 0.002


def test_a_slanted_plane_digitises_as_well():
    with s3d.open_sim("three_boxes", 1000, mounted(0, 0, 40)) as (robot, truth):
        session = s3d.digitize(robot, s3d.Config(max_views=2))
        result = s3d.evaluate(session, truth)
    assert result.pairs[0].error < 0.010
    assert result.accuracy.median < 0.008
