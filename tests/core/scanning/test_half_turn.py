"""Panoramas of half a turn, by a lidar that sees all round."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import scan3d_twin as s3d
from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.hal import default_mount
from scan3d_twin.core.line_grid import make_full_circle
from scan3d_twin.core.scanning.calibration.extrinsics import apply_mount
from scan3d_twin.core.scanning.calibration.half_turn import is_unfolded, sees_all_round, unfold
from scan3d_twin.core.scanning.calibration.lidar_mount import calibrate_on_panorama
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.types import VALID, Observation, RangeImage, read_only
from scan3d_twin.devices.registry import lidar_device

SPEC = make_full_circle(90, 0.1, 0.02, 12.0)


def sweep_half_turn(seed: int, mount: MountConfig) -> RangeImage:
    """Return half a turn of readings at random ranges, with a mount that is off."""
    rng = np.random.default_rng(seed)
    n, m = 95, SPEC.n_beams
    stamps = 3.0 + 0.1 * np.arange(n)[::-1]
    turn = (stamps - stamps.mean())[:, None] + SPEC.beam_times - SPEC.beam_times[m // 2]
    ranges = rng.uniform(0.5, 4.0, (n, m))
    ranges[rng.random((n, m)) < 0.1] = np.nan
    own = SPEC.elevations + rng.uniform(-0.2, 0.2, (n, m)) * (math.tau / 90)
    return RangeImage(
        stamps=read_only(stamps),
        yaws=read_only(np.radians(20.0) * turn),
        ranges=read_only(ranges),
        codes=read_only(np.where(np.isfinite(ranges), VALID, 0), np.int64),
        spec=SPEC,
        T_base_lidar=read_only(apply_mount(default_mount(), mount)),
        elevations=read_only(own),
    )


def test_it_is_known_which_lidars_see_all_round() -> None:
    assert sees_all_round(SPEC)
    assert sees_all_round(lidar_device("ld19").spec("230400"))
    assert not sees_all_round(lidar_device("urg04lx").spec("usb"))


@pytest.mark.parametrize(
    "mount", [MountConfig(), MountConfig(lateral=0.01, roll=0.02, pitch=-0.03)]
)
def test_points_stay_where_they_are(mount: MountConfig) -> None:
    image = sweep_half_turn(0, mount)
    whole = unfold(image)
    assert is_unfolded(whole)
    assert not is_unfolded(image)

    # Each point of the unfolded image is one of the half turn, and hardly one is missing
    old = image.points[image.codes == VALID]
    new = whole.points[whole.codes == VALID]
    assert cKDTree(old).query(new)[0].max() < 1e-12
    inside = np.abs(image.yaws) < math.pi / 2 - 0.1
    assert len(new) > 0.97 * np.count_nonzero((image.codes == VALID) & inside)


def test_the_lines_look_ahead_all_round() -> None:
    whole = unfold(sweep_half_turn(1, MountConfig()))
    middle = whole.yaws[:, whole.spec.n_beams // 2]
    assert np.all(np.diff(middle) < 0)
    assert np.max(-np.diff(middle)) < math.radians(4.5)
    assert middle[0] > math.pi - 0.05
    assert middle[-1] < -math.pi + 0.05
    assert np.abs(whole.spec.elevations).max() <= math.pi / 2
    assert np.all(np.isfinite(whole.yaws))
    assert np.all(np.isfinite(whole.elevation_rows))


def look(config: s3d.TwinConfig) -> tuple[Observation, float]:
    """Return a panorama and how long it took [s]."""
    with s3d.open_sim("three_boxes", 1000, config) as (robot, _):
        return take_panorama(robot, s3d.Config(), lambda line: None), robot.clock.now()


def test_half_a_turn_shows_all_that_a_full_turn_shows() -> None:
    ideal = s3d.TwinConfig.of("ideal", lidar="ld19")
    seen, took = look(ideal)
    _, full = look(s3d.TwinConfig.of("ideal"))
    assert took < 0.6 * full

    # The floor is where it is, in front and behind
    image = seen.image
    points = image.points[(image.codes == VALID) & (np.abs(image.heights) < 0.05)]
    assert np.percentile(np.abs(points[:, 2]), 95) < 0.002
    bearings = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert np.histogram(bearings, 36, (-180, 180))[0].min() > 20


@pytest.mark.parametrize("scale", [-0.015, 0.015])
def test_the_error_of_a_turn_is_measured_by_half_a_turn(scale: float) -> None:
    """As if the odometry said less or more than the base turned; it slips by 0.3 % as it is."""
    ideal = s3d.TwinConfig.of("ideal", lidar="ld19")
    with s3d.open_sim("three_boxes", 1000, ideal) as (robot, truth):
        image = take_panorama(robot, s3d.Config(), lambda line: None).image
        odometry = robot.base.odometry_since(0.0)
        stamps = np.array([each.stamp for each in odometry])
        yaws = np.unwrap([each.T_odom_base.yaw for each in odometry])
        true = np.unwrap([truth.pose_at(stamp).yaw for stamp in stamps])
    first, last = np.argmin(yaws), np.argmax(yaws)
    slip = (true[last] - true[first]) / (yaws[last] - yaws[first]) - 1

    middle = image.yaws[:, image.spec.n_beams // 2][:, None]
    behind = np.abs(middle) > math.pi / 2
    base = np.where(behind, image.yaws - np.copysign(math.pi, middle), image.yaws)
    for error in (0.0, scale):
        wrong = image.yaws - base + base / (1.0 + error)
        found = calibrate_on_panorama(replace(image, yaws=read_only(wrong)))
        assert found is not None
        assert found.mount.yaw_scale == pytest.approx(slip + error, abs=0.0015)
        assert abs(found.mount.roll) < 0.004
