"""Odometry from readings that wrap, jump, come late or get lost."""

import math

import numpy as np
import pytest

from scan3d_twin.core.hal import BaseSpec
from scan3d_twin.devices.create.driving.dead_reckoning import (
    RESTART_AFTER,
    CommandedReckoning,
    CommandedWheels,
    EncoderReckoning,
    SampleTimes,
    make_reckoning,
)
from scan3d_twin.devices.create.packets import Packet

SPEC = BaseSpec("create2", 0.165, 0.235, 0.072, 508.8, 0.5, 0.015)
PERIOD = 0.015
MM_PER_COUNT = math.pi * 72 / 508.8


def counts(left, right):
    return {Packet.LEFT_COUNTS: left & 0xFFFF, Packet.RIGHT_COUNTS: right & 0xFFFF}


def driven(reckoning, steps, each, start=0):
    """Feed ``steps`` readings, ``each`` counts (left, right) apart; return the last odometry."""
    for k in range(1, steps + 1):
        odometry = reckoning.take(k * PERIOD, counts(start + k * each[0], start + k * each[1]))
    return odometry


@pytest.mark.parametrize("start", [0, 5, 65530])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_drive_across_zero_is_exact_in_both_directions(start, sign):
    # 0.60 m backwards across zero must not become 28 m.
    reckoning = EncoderReckoning(SPEC, 0.0, counts(start, start))
    reckoning.drive(0.0, sign * 0.3, 0.0)
    odometry = driven(reckoning, 135, (10 * sign, 10 * sign), start)
    assert odometry.T_odom_base.x == pytest.approx(sign * 1.350 * MM_PER_COUNT, abs=1e-9)
    assert odometry.T_odom_base.yaw == 0.0


def test_a_turn_to_the_left_is_positive():
    reckoning = EncoderReckoning(SPEC, 0.0, counts(0, 0))
    odometry = driven(reckoning, 100, (-2, 2))
    assert odometry.T_odom_base.yaw == pytest.approx(400 * MM_PER_COUNT / 235)


def test_counts_far_from_the_command_need_a_second_reading_that_goes_on_from_there():
    reckoning = EncoderReckoning(SPEC, 0.0, counts(0, 0))
    assert reckoning.take(PERIOD, counts(0, 0)) is not None
    assert reckoning.take(2 * PERIOD, counts(15, 15)) is None
    assert reckoning.take(3 * PERIOD, counts(30, 30)).T_odom_base.x == pytest.approx(
        0.030 * MM_PER_COUNT
    )


def test_one_wrong_reading_leaves_no_trace():
    reckoning = EncoderReckoning(SPEC, 0.0, counts(0, 0))
    reckoning.drive(0.0, 0.3, 0.0)
    assert driven(reckoning, 50, (10, 10)).T_odom_base.x == pytest.approx(0.5 * MM_PER_COUNT)
    assert reckoning.take(51 * PERIOD, counts(510 + 16, 510)) is None
    assert reckoning.take(52 * PERIOD, counts(520, 520)).T_odom_base.x == pytest.approx(
        0.52 * MM_PER_COUNT
    )


def test_a_counter_that_begins_anew_moves_nothing():
    reckoning = EncoderReckoning(SPEC, 0.0, counts(30_000, 30_000))
    before = reckoning.take(PERIOD, counts(30_000, 30_000))
    for k in range(RESTART_AFTER - 1):
        assert reckoning.take((2 + k) * PERIOD, counts(7, 9)) is None
    after = reckoning.take((1 + RESTART_AFTER) * PERIOD, counts(7, 9))
    assert after.T_odom_base == before.T_odom_base
    later = reckoning.take((2 + RESTART_AFTER) * PERIOD, counts(9, 11))
    assert later.T_odom_base.x == pytest.approx(0.002 * MM_PER_COUNT)


def test_wheels_follow_their_commands_as_fast_as_they_can():
    wheels = CommandedWheels(SPEC, 1.0)
    wheels.drive(0.18, 0.0)
    assert wheels.advance(1.1) == pytest.approx((0.009, 0.009))
    assert wheels.advance(1.2) == pytest.approx((0.018, 0.018))
    wheels.drive(0.0, 1.0)
    assert wheels.advance(1.2) == (0.0, 0.0)
    left, right = wheels.advance(2.2)
    # 1 s at -+0.1175 m/s, and what the ramps of 0.165 s and 0.035 s add.
    assert left == pytest.approx(-0.1175 + 0.1653 * 0.2975 / 2, abs=1e-4)
    assert right == pytest.approx(0.1175 + 0.0347 * 0.0625 / 2, abs=1e-4)


def test_a_create_1_is_where_its_commands_lead_and_readings_correct_it():
    reckoning = make_reckoning(SPEC, 0.0, {})
    assert isinstance(reckoning, CommandedReckoning)
    at_rest = {Packet.DISTANCE: 0, Packet.ANGLE: 0}
    reckoning.take(PERIOD, at_rest)
    reckoning.drive(PERIOD, 0.18, 0.0)
    assert reckoning.take(1.0 + PERIOD, {}).T_odom_base.x == pytest.approx(0.171)
    reckoning.drive(1.0 + PERIOD, 0.0, 0.0)
    reckoning.take(1.3, {})
    assert reckoning.unread
    # 180 mm were commanded; what is read lies between 183 and 184.
    read = {Packet.DISTANCE: 183, Packet.ANGLE: 2}
    odometry = reckoning.take(1.5, read)
    assert odometry.T_odom_base.x == pytest.approx(0.183, abs=0.001)
    assert odometry.T_odom_base.yaw == pytest.approx(math.radians(2.0))
    assert not reckoning.unread


def test_a_reading_in_doubt_changes_nothing_but_what_is_known():
    reckoning = CommandedReckoning(SPEC, 0.0)
    reckoning.take(PERIOD, {Packet.DISTANCE: 0, Packet.ANGLE: 0})
    reckoning.drive(PERIOD, 0.0, 1.0)
    sure = reckoning.take(1.0, {})
    reckoning.drive(1.0, 0.0, 0.0)
    wrong = {Packet.DISTANCE: 16_384, Packet.ANGLE: -90}
    odometry = reckoning.take(1.5, wrong, doubtful=True)
    assert odometry.T_odom_base.x == 0.0
    assert odometry.T_odom_base.yaw == pytest.approx(1.0, abs=0.05)
    assert odometry.covariance[2, 2] > sure.covariance[2, 2]
    assert reckoning.take(1.6, {}).covariance[2, 2] > 0.04**2


def test_stamps_follow_the_earliest_arrivals():
    times, rng = SampleTimes(PERIOD, 0.002), np.random.default_rng(0)
    true = PERIOD * np.arange(1, 400)
    late = rng.exponential(0.002, len(true))
    stamps = [times.stamps(1, t + 0.002 + d)[0] for t, d in zip(true, late, strict=True)]
    assert np.abs(np.array(stamps[100:]) - true[100:]).max() < 0.001


def test_readings_that_come_in_a_lump_were_measured_one_after_the_other():
    times = SampleTimes(PERIOD, 0.0)
    times.stamps(1, 1.0)
    assert times.stamps(4, 1.06) == pytest.approx([1.015, 1.03, 1.045, 1.06])


def test_after_lost_readings_the_arrival_tells_the_time():
    times = SampleTimes(PERIOD, 0.0)
    times.stamps(1, 1.0)
    assert times.stamps(1, 1.045) == pytest.approx([1.015], abs=1e-4)
    assert times.stamps(1, 1.075, gap=True) == pytest.approx([1.075], abs=1e-4)


def test_a_jump_no_wheel_can_make_is_not_believed_because_much_time_has_passed():
    reckoning = EncoderReckoning(SPEC, 0.0, counts(0, 0))
    driven(reckoning, 1000, (0, 0))
    assert reckoning.take(1001 * PERIOD, counts(100, 100)) is None
    assert reckoning.take(1002 * PERIOD, counts(101, 101)) is None


def test_a_turn_that_was_only_commanded_is_known_by_5_percent_until_it_is_read():
    reckoning = CommandedReckoning(SPEC, 0.0)
    reckoning.take(PERIOD, {Packet.DISTANCE: 0, Packet.ANGLE: 0})
    reckoning.drive(PERIOD, 0.0, 1.0)
    turning = reckoning.take(2.0 + PERIOD, {}).covariance
    assert 0.05 * 1.9 < math.sqrt(turning[2, 2]) < 0.06 * 2.1
    assert turning[0, 0] == turning[1, 1] == 0.0
    reckoning.drive(2.0 + PERIOD, 0.0, 0.0)
    read = reckoning.take(3.0, {Packet.DISTANCE: 0, Packet.ANGLE: 114}).covariance
    assert read[2, 2] < turning[2, 2]
