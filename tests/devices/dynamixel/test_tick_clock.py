"""The servo's timer on the host's clock."""

import numpy as np
import pytest

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.dynamixel.model import TICK, TICK_PERIOD
from scan3d_twin.devices.dynamixel.tick_clock import RestartedError, TickClock


def tick_at(time, begin=0.0, skew=0.0):
    """Return the timer at ``time`` [s] of a servo that was switched on at ``begin``."""
    return int((time - begin) * (1 + skew) / TICK) % TICK_PERIOD


def errors(times, delays, skew=0.0, begin=-30.0):
    """Return the errors of the stamps of readings at ``times``, asked ``delays`` before [s]."""
    clock = TickClock()
    stamps = [
        clock.stamp(tick_at(time, begin, skew), time - delay, time + 0.004)
        for time, delay in zip(times, delays, strict=True)
    ]
    return np.array(stamps) - times


def test_undelayed_questions_are_stamped_exactly_over_several_wraps():
    times = np.arange(1.0, 120.0, 0.0257)
    assert np.abs(errors(times, np.zeros(len(times)))).max() < 1e-9


def test_delayed_questions_are_stamped_to_a_tick_and_a_half():
    rng = np.random.default_rng(3)
    times = np.arange(1.0, 30.0, 0.0057)
    delays = rng.exponential(0.004, len(times)).clip(0, 0.03)
    off = errors(times, delays)
    assert np.abs(off[100:]).max() <= 1.5 * TICK
    assert np.abs(off).max() < 0.03


@pytest.mark.parametrize("skew", [-0.0005, 0.0005])
def test_a_clock_that_is_off_stays_in_place(skew):
    times = np.arange(1.0, 200.0, 0.0111)
    delays = np.random.default_rng(1).exponential(0.002, len(times))
    assert np.abs(errors(times, delays, skew)[100:]).max() < TICK + 0.0005 * 10.0


def test_pauses_of_any_length_are_bridged():
    times = np.cumsum([1.0, 0.005, 15.0, 0.005, 16.4, 0.005, 70.0, 0.005, 300.0, 0.005])
    assert np.abs(errors(times, np.zeros(len(times)))).max() < 1e-9


def test_a_garbled_timer_is_refused_and_a_new_one_is_noticed():
    clock = TickClock()
    for time in (1.0, 1.01, 1.02):
        clock.stamp(tick_at(time), time, time + 0.005)
    with pytest.raises(ProtocolError, match="does not fit"):
        clock.stamp(tick_at(1.03) ^ 0x400, 1.03, 1.035)
    assert clock.stamp(tick_at(1.04), 1.04, 1.045) == pytest.approx(1.04)
    for time in (1.05, 1.06):
        with pytest.raises(ProtocolError, match="does not fit"):
            clock.stamp(tick_at(time, 1.03), time, time + 0.005)
    with pytest.raises(RestartedError, match="did its supply break down"):
        clock.stamp(tick_at(1.07, 1.03), 1.07, 1.075)


def test_an_answer_of_the_future_is_refused():
    clock = TickClock()
    for time in (1.0, 1.01, 1.02):
        clock.stamp(tick_at(time), time, time + 0.005)
    with pytest.raises(ProtocolError):
        clock.stamp(tick_at(1.1), 1.065, 1.07)


def test_a_servo_that_lags_behind_at_times_is_stamped_as_without_lag():
    """As a lidar is: the time that its least delay says."""
    rng = np.random.default_rng(2)
    times = np.arange(1.0, 30.0, 0.01)
    lags = np.interp(times, np.arange(0, 31), rng.uniform(0.0, 0.3, 31) * (np.arange(31) % 3 > 0))
    clock = TickClock()
    stamps = np.array(
        [
            clock.stamp(tick_at(time - lag), time, time + 0.004)
            for time, lag in zip(times, lags, strict=True)
        ]
    )
    assert np.abs(stamps - (times - lags))[400:].max() < 0.004 + TICK
