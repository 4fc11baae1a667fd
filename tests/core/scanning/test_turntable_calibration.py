"""A scanner with a turntable that is calibrated from scans alone."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic

from scan3d_twin.core.config import MountConfig
from scan3d_twin.core.scanning.calibration.extrinsics import correct_extrinsics
from scan3d_twin.core.scanning.calibration.lidar_mount import Calibration, calibrate
from scan3d_twin.core.scanning.patterns import LEVER, find_axis_mount, find_mount
from scan3d_twin.core.types import VALID, LidarSpec, Observation, Pose2, RangeImage, read_only

pytestmark = pytest.mark.slow

ROOM = (synthetic.Box((1.2, -0.6, 0.0), (1.6, 0.8, 0.9)),)
DEGREE = math.radians(1.0)
WRONG = MountConfig(
    lateral=0.010, roll=1.0 * DEGREE, pitch=-0.7 * DEGREE, time_offset=0.020, yaw=0.8 * DEGREE,
    play=0.4 * DEGREE, axis_roll=-0.9 * DEGREE, axis_pitch=1.2 * DEGREE,
)  # fmt: skip
SLOW, FAST = 5.0 * DEGREE, 15.0 * DEGREE
COARSE = LidarSpec(
    elevations=read_only(np.radians(np.arange(-119.0, 119.5, 1.0))),
    beam_times=read_only(np.arange(239) * 2e-4),
    line_period=0.1,
    min_range=0.02,
    max_range=4.0,
)
"""A lidar of one beam per degree."""


def take(pattern: str, rate: float, *, half: float = math.pi) -> Observation:
    """Return a sweep of the room at ``rate`` by a scanner that is ``WRONG`` and does not know it.

    Lines are 2 degrees apart; negative rates turn to the right.
    """
    # As it is believed to be
    mount = find_mount(pattern)
    assert mount is not None
    middle = np.arange(half, -half - 1e-9, -2 * DEGREE)
    stamps = middle / rate
    yaws = middle[:, None] + rate * (COARSE.beam_times - COARSE.beam_times[119])
    believed = RangeImage(
        stamps=read_only(stamps),
        yaws=read_only(yaws),
        ranges=read_only(np.ones(yaws.shape)),
        codes=read_only(np.full(yaws.shape, VALID), np.int64),
        spec=COARSE,
        T_base_lidar=find_axis_mount(mount.T_base_axis, mount.T_base_lidar),
        T_scan_axis=mount.T_base_axis,
    )

    # As it is
    true = correct_extrinsics(Observation(believed, Pose2()), WRONG).image
    pose, rays = Pose2(0.1, -0.2, 0.3), true.directions
    origins = pose.apply(true.points - rays)
    ranges = synthetic.cast(
        origins.reshape(-1, 3), pose.rotate(rays).reshape(-1, 3), ROOM, room=True
    ).reshape(yaws.shape)
    rng = np.random.default_rng(abs(round(1e4 * rate)))
    ranges = ranges + 0.003 * rng.standard_normal(ranges.shape)
    seen = np.where(ranges < 4.0, ranges, np.nan)
    codes = np.where(np.isfinite(seen), VALID, 0)
    measured = replace(believed, ranges=read_only(seen), codes=read_only(codes, np.int64))
    return Observation(measured, Pose2())


@cache
def found_by(pattern: str, *rates: float) -> Calibration:
    """Return what sweeps both ways at each of ``rates`` show."""
    return calibrate([[take(pattern, way * rate).image for way in (-1, 1)] for rate in rates])


def known(found: Calibration) -> dict[str, bool]:
    return dict(zip(found.names, found.known, strict=True))


def degrees(found: Calibration, name: str) -> float:
    return math.degrees(getattr(found.mount, name))


def test_two_rates_tell_play_and_delay_apart() -> None:
    found = found_by("yaw", SLOW, FAST)
    assert degrees(found, "play") == pytest.approx(0.4, abs=0.08)
    assert found.mount.time_offset == pytest.approx(0.020, abs=0.004)


def test_lever_tilt_and_lean_of_the_axis_are_found() -> None:
    found = found_by("yaw", SLOW, FAST)
    # Across the plane as the lidar is turned about the axis, which is the gauge
    across = 0.010 * math.cos(WRONG.yaw) - LEVER * math.sin(WRONG.yaw)
    assert found.mount.lateral == pytest.approx(across, abs=0.0015)
    assert degrees(found, "roll") == pytest.approx(1.0, rel=0.10)
    assert degrees(found, "pitch") == pytest.approx(-0.7, rel=0.10)
    assert degrees(found, "axis_roll") == pytest.approx(-0.9, rel=0.10)
    assert degrees(found, "axis_pitch") == pytest.approx(1.2, rel=0.10)


def test_what_nothing_can_show_is_unknown_without_an_end() -> None:
    found = found_by("yaw", SLOW, FAST)
    assert found.turned_about == "yaw"
    assert not known(found)["yaw"]
    assert math.isinf(found.sigmas[found.names.index("yaw")])


def test_at_one_rate_neither_play_nor_delay_is_known() -> None:
    found = found_by("roll", FAST)
    for name in ("play", "time_offset"):
        assert not known(found)[name]
        assert math.isinf(found.sigmas[found.names.index(name)])
        assert getattr(found.mount, name) == 0.0


def test_a_lidar_that_looks_along_its_axis_may_be_turned_out_of_it() -> None:
    found = found_by("roll", FAST)
    assert (found.turned_about, found.same_as) == ("roll", "axis_roll")
    assert degrees(found, "yaw") == pytest.approx(0.8, rel=0.10)
    assert degrees(found, "pitch") == pytest.approx(-0.7, rel=0.10)
    # Its lean is that of the angle's zero, and shows against the floor
    assert degrees(found, "axis_roll") == pytest.approx(1.0 - 0.9, abs=0.05)


def test_a_corrected_sweep_lies_where_the_room_is() -> None:
    seen = take("pitch", FAST, half=0.5)
    points = correct_extrinsics(seen, WRONG).image.points
    floor = points[np.abs(points[..., 2]) < 0.03][:, 2]
    assert len(floor) > 500
    assert abs(np.median(floor)) < 0.001
    off = seen.image.points[..., 2][np.abs(points[..., 2]) < 0.03]
    assert np.median(np.abs(off)) > 0.01
