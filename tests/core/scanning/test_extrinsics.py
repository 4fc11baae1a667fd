"""A mount that is corrected, and one that is found from scans alone."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic
from paper import paper_config, paper_sweep

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.hal import default_mount
from scan3d_twin.core.scanning.calibration.extrinsics import (
    apply_mount,
    compose_mounts,
    correct_extrinsics,
    describe_mount,
    measure_turn_rate,
    tilt_matrix,
)
from scan3d_twin.core.scanning.calibration.lidar_mount import (
    PARAMETERS,
    Calibration,
    apply_yaw_scale,
    calibrate,
    calibrate_on_panorama,
    find_planes,
)
from scan3d_twin.core.types import Observation, Pose2, RangeImage, read_only

pytestmark = pytest.mark.slow

ROOM = (
    synthetic.Box((1.2, -0.6, 0.0), (1.6, 0.8, 0.9)),
    synthetic.Box((-1.6, -1.4, 0.0), (-1.0, -0.6, 0.5)),
)
WRONG = MountConfig(0.010, math.radians(1.0), math.radians(-0.5), 0.012, 0.0)


def take(
    wrong: MountConfig, *, width: float = 364.0, rightwards: bool = True, seed: int = 1
) -> Observation:
    """Return a sweep of a room by a lidar that sits ``wrong``, as one that does not know it."""
    seen = synthetic.observe(
        Pose2(0.1, -0.2, 0.3), ROOM, width=math.radians(width), step=math.radians(1.0)
    )  # fmt: skip
    image = seen.image
    stamps = image.stamps if rightwards else image.stamps[::-1]
    truth = replace(
        image,
        stamps=read_only(stamps),
        T_base_lidar=read_only(apply_mount(default_mount(), wrong)),
    )
    rate = measure_turn_rate(truth)
    true_yaws = (1 + wrong.yaw_scale) * image.yaws + wrong.time_offset * rate
    truth = replace(truth, yaws=read_only(true_yaws), ranges=read_only(np.ones(image.ranges.shape)))
    pose = Pose2(0.1, -0.2, 0.3)
    d = pose.rotate(truth.directions)
    o = pose.apply(truth.points - truth.directions)
    ranges = synthetic.cast(o.reshape(-1, 3), d.reshape(-1, 3), ROOM, room=True)
    rng = np.random.default_rng(seed)
    ranges = ranges.reshape(image.ranges.shape) + 0.004 * rng.standard_normal(image.ranges.shape)
    ranges = np.where(ranges < 4.0, ranges, np.nan)
    measured = replace(
        truth,
        yaws=image.yaws,
        ranges=read_only(ranges),
        codes=read_only(np.where(np.isfinite(ranges), -1, 0), np.int64),
        T_base_lidar=default_mount(),
    )
    return Observation(measured, Pose2())


@cache
def full_turn(wrong: MountConfig) -> Calibration:
    """Return the calibration from one full turn with a ``wrong`` mount."""
    return calibrate([[take(wrong).image]])


def test_a_full_turn_tells_offset_tilt_and_yaw_scale() -> None:
    found = full_turn(WRONG)
    assert found.known == (True, True, True, True, False)
    assert found.mount.lateral == pytest.approx(WRONG.lateral, rel=0.10)
    assert found.mount.roll == pytest.approx(WRONG.roll, rel=0.10)
    assert found.mount.pitch == pytest.approx(WRONG.pitch, rel=0.10)
    assert found.mount.yaw_scale == pytest.approx(WRONG.yaw_scale, rel=0.10)
    assert found.mount.time_offset == 0.0
    assert found.flatness < 0.003


def test_a_good_mount_is_found_good_within_its_errors() -> None:
    found = full_turn(MountConfig())
    values = [found.mount.lateral, found.mount.roll, found.mount.pitch, found.mount.yaw_scale]
    assert np.all(np.abs(values) < 4 * found.sigmas[:4])
    assert found.sigmas[0] < 0.002
    assert found.sigmas[1] < math.radians(0.1)


def test_sweeps_to_both_sides_tell_the_time_offset() -> None:
    wrong = replace(WRONG, time_offset=0.05)
    sweeps = [take(wrong, width=300, rightwards=side).image for side in (True, False)]
    found = calibrate([sweeps])
    assert found.known[4]
    assert found.mount.time_offset == pytest.approx(0.05, abs=0.005)
    assert found.mount.roll == pytest.approx(wrong.roll, rel=0.10)


def test_correcting_by_what_was_found_leaves_nothing_to_find() -> None:
    first = take(WRONG)
    found = full_turn(WRONG)
    again = calibrate([[correct_extrinsics(first, found.mount).image]])
    assert abs(again.mount.lateral) < 0.001
    assert abs(again.mount.roll) < math.radians(0.1)
    assert abs(again.mount.yaw_scale) < 0.001


def test_a_correct_mount_changes_nothing() -> None:
    seen = take(MountConfig())
    assert correct_extrinsics(seen, MountConfig()) is seen


def test_corrections_add_up() -> None:
    both = compose_mounts(WRONG, WRONG)
    assert both.lateral == pytest.approx(2 * WRONG.lateral)
    assert 1 + both.yaw_scale == pytest.approx((1 + WRONG.yaw_scale) ** 2)
    assert "+10.0 mm" in describe_mount(WRONG)


def test_the_tilt_leans_right_and_looks_down() -> None:
    assert tilt_matrix(0.1, 0.0) @ [0, 0, 1] == pytest.approx([0, -math.sin(0.1), math.cos(0.1)])
    assert tilt_matrix(0.0, 0.1) @ [1, 0, 0] == pytest.approx([math.cos(0.1), 0, -math.sin(0.1)])


def test_planes_are_told_apart() -> None:
    y, z = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(0, 1, 15))
    wall = np.stack([np.full(y.size, 2.0), y.ravel(), z.ravel()], axis=1)
    points = np.concatenate([wall, wall[:, [1, 0, 2]]])
    normals = np.repeat([[-1.0, 0, 0], [0, -1.0, 0]], len(wall), axis=0)
    planes = find_planes(points, normals, np.zeros(len(points), np.int64))
    assert sorted(len(plane) for plane in planes) == [225, 225]


def nothing(image: RangeImage) -> RangeImage:
    """Return ``image`` without any valid reading."""
    return replace(
        image,
        ranges=read_only(np.full(image.ranges.shape, np.nan)),
        codes=read_only(np.zeros(image.ranges.shape), np.int64),
    )


def test_scans_without_walls_are_refused() -> None:
    with pytest.raises(RegistrationError, match="no scan"):
        calibrate([])
    with pytest.raises(RegistrationError, match="too little surface"):
        calibrate([[nothing(take(MountConfig()).image)]])


def test_scans_with_different_mounts_are_refused() -> None:
    one = take(MountConfig()).image
    other = replace(one, T_base_lidar=read_only(apply_mount(default_mount(), WRONG)))
    with pytest.raises(ConfigError, match="different mounts"):
        calibrate([[one], [other]])


@pytest.mark.parametrize("name", ["lateral", "roll", "pitch", "yaw_scale", "time_offset"])
def test_an_impossible_mount_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=f"mount.{name}"):
        MountConfig(**{name: 5.0})


def test_a_run_turns_as_its_first_look_tells_if_that_is_wanted() -> None:
    config = replace(
        paper_config(), sweep=paper_sweep(turning="look"), mount=MountConfig(yaw_scale=0.01)
    )
    found = full_turn(WRONG)
    tuned = apply_yaw_scale(config, found)
    off = tuned.mount.yaw_scale - (1.01 * (1 + WRONG.yaw_scale) - 1)
    assert replace(tuned.mount, yaw_scale=0.01) == config.mount  # the rest is left alone

    # The sweeps' yaws are as accurate as the panorama's, no less
    left = float(found.sigmas[PARAMETERS.index("yaw_scale")])
    sigma = tuned.registration.yaw_scale_sigma
    assert left < sigma < math.hypot(left, 0.0002)
    assert abs(off) < 3 * sigma


def test_else_it_turns_as_the_odometry_tells() -> None:
    config = paper_config()
    assert apply_yaw_scale(config, full_turn(WRONG)) == config


def test_a_look_at_nothing_tells_nothing() -> None:
    config = replace(paper_config(), sweep=paper_sweep(turning="look"))
    look = take(WRONG).image
    blind = replace(look, ranges=read_only(np.full(look.ranges.shape, np.nan)))
    assert calibrate_on_panorama(blind) is None
    assert apply_yaw_scale(config, None) == config


def test_the_roll_of_a_lidar_that_looks_along_its_axis_is_not_found():
    image = take(MountConfig()).image
    T = np.array(image.T_base_lidar)
    # The same beams of a lidar that looks along the axis
    T[:3, :3] = [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    spec = replace(image.spec, elevations=image.spec.elevations - math.pi / 2)
    rolled = replace(image, T_base_lidar=T, spec=spec)
    assert np.nanmax(np.abs(rolled.points - image.points)) < 1e-9
    found = calibrate([[rolled]])
    assert not found.known[PARAMETERS.index("roll")]
    assert found.mount.roll == 0.0
