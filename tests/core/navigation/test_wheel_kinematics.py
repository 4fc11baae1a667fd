import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.core.navigation.wheel_kinematics import (
    WHEEL_ACCELERATION,
    correct_reading,
    ramp_speed,
    split_velocity,
)

SPEC = BaseSpec("create1", 0.165, 0.258, 0.078, 245.0, 0.5, 0.015)
SPEED = st.floats(-0.5, 0.5)


@given(SPEED, st.floats(-4.0, 4.0))
def test_a_command_keeps_its_curvature_and_no_wheel_is_too_fast(linear, angular):
    left, right = split_velocity(SPEC, linear, angular)
    assert max(abs(left), abs(right)) <= 0.5 + 1e-12
    wanted = (linear - angular * 0.129, linear + angular * 0.129)
    scale = min(1.0, 0.5 / max(map(abs, wanted), default=1.0) if any(wanted) else 1.0)
    assert (left, right) == pytest.approx([scale * speed for speed in wanted], abs=0.00051)


def test_the_rounding_of_a_stop_does_not_drive_a_base_with_a_least_speed():
    slow = replace(SPEC, min_wheel_speed=0.02)
    assert split_velocity(slow, 0.0, 1e-17) == (0.0, 0.0)
    assert split_velocity(slow, 0.005, 0.0) == pytest.approx((0.02, 0.02))


@given(SPEED, SPEED, st.floats(0.0, 2.0))
def test_a_ramp_in_two_parts_is_the_ramp_in_one(speed, target, time):
    way, after = ramp_speed(speed, target, time)
    first, between = ramp_speed(speed, target, 0.3 * time)
    second, end = ramp_speed(between, target, 0.7 * time)
    assert way == pytest.approx(first + second, abs=1e-9)
    assert after == pytest.approx(end, abs=1e-9)
    assert abs(after - speed) <= WHEEL_ACCELERATION * time + 1e-9


def test_a_ramp_takes_its_time():
    # From rest to 0.36 m/s in 0.2 s: 36 mm, and 36 mm more in another 0.1 s.
    assert ramp_speed(0.0, 0.36, 0.3) == pytest.approx((0.072, 0.36))
    assert ramp_speed(0.36, 0.0, 0.1) == pytest.approx((0.027, 0.18))


@given(st.floats(-2.0, 2.0), st.floats(-3.0, 3.0))
def test_what_is_true_needs_no_correction(way, turn):
    added = correct_reading(way, turn, int(1e3 * way), int(math.degrees(turn)))
    assert added == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("commanded", "read", "corrected"),
    [(10.0, 12, 12.0), (15.0, 12, 13.0), (-10.0, -12, -12.0), (-15.0, -12, -13.0), (3.0, 0, 1.0)],
)
def test_a_reading_moves_the_command_to_the_nearer_of_its_two_numbers(commanded, read, corrected):
    way, turn = correct_reading(commanded / 1e3, math.radians(commanded), read, read)
    assert 1e3 * way + commanded == pytest.approx(corrected)
    assert math.degrees(turn) + commanded == pytest.approx(corrected)
