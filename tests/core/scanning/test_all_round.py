"""What a sweep by a lidar that sees all round shows, and what of it is not used."""

from __future__ import annotations

import math

import numpy as np
import pytest

import scan3d_twin as s3d
from scan3d_twin.core.registration.surfels.grid import extract_surfels
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.scanning.target.extraction import extract_points, is_in_window
from scan3d_twin.core.types import UNMEASURED, VALID, RangeImage

CONFIG = s3d.Config()


@pytest.fixture(scope="module")
def image() -> RangeImage:
    config = s3d.TwinConfig.of("typical", lidar="ld19")
    with s3d.open_sim("three_boxes", 1000, config) as (robot, _):
        return sweep(robot, 0.0, CONFIG, lambda line: None, half=math.radians(20.0)).image


def test_the_robot_itself_and_the_floor_are_left_out(image: RangeImage) -> None:
    # The lidar does see both
    seen = image.points[image.codes == VALID]
    near = np.hypot(seen[:, 0], seen[:, 1]) < CONFIG.motion.self_radius
    assert np.count_nonzero(near) > 1000
    assert np.count_nonzero(np.abs(seen[:, 2]) < 0.01) > 1000

    scan = extract_points(image, CONFIG)
    assert np.hypot(scan.points[:, 0], scan.points[:, 1]).min() > CONFIG.motion.self_radius
    floor = scan.points[:, 2] < CONFIG.target.floor_height / 2
    assert not floor.any()


def test_what_is_behind_is_no_target_but_helps_registration(image: RangeImage) -> None:
    scan = extract_points(image, CONFIG)
    behind = scan.points[:, 0] < 0
    assert np.count_nonzero(behind) > 1000
    modelled = is_in_window(image, scan.lines, scan.beams, CONFIG.target)
    assert not np.any(modelled & behind)
    assert np.count_nonzero(modelled) > 1000

    index = extract_surfels(image, keep=scan).index
    back = np.abs(image.spec.elevations) > math.pi / 2
    assert np.count_nonzero(index[:, back] >= 0) > 0.5 * np.count_nonzero(behind)


def test_beams_are_not_smeared_over_the_grid(image: RangeImage) -> None:
    """Each reading keeps its own angle and heading; no angle is measured twice in a line."""
    own = image.elevations
    assert own is not None
    there = image.codes != UNMEASURED
    assert 445 <= np.median(np.count_nonzero(there, axis=1)) <= 455
    for line in range(image.n_lines):
        angles = own[line, there[line]]
        assert np.diff(angles).min() > 0.9 * math.tau / 455
    offsets = (own - image.spec.elevations)[there] / (math.tau / 450)
    assert np.ptp(offsets) > 0.9
    turned = np.degrees(np.abs(image.yaws[:, -1] - image.yaws[:, 0]))
    assert np.mean(turned) == pytest.approx(5.0 * 0.1, rel=0.1)
