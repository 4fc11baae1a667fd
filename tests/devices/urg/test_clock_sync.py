"""The lidar's timer on the host's clock."""

import numpy as np
import pytest

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.urg.clock_sync import LATENCIES, SensorClock

pytestmark = pytest.mark.slow

LATENCY = 0.101


def sensor_ms(seconds, start=0.0, skew=0.0):
    return int((start + seconds * (1 + skew)) * 1000) % (1 << 24)


def run(clock, times, *, delay=lambda i: 0.0, **sensor):
    """Feed a scan for each time; return the error of each stamp [s]."""
    return np.array(
        [
            clock.stamp(sensor_ms(t, **sensor), t + LATENCY + delay(i)) - t
            for i, t in enumerate(times)
        ]
    )


def anchored(latency=LATENCY, late=0.001, **sensor):
    clock = SensorClock(latency)
    for t in (-0.4, -0.3, -0.2):
        clock.anchor(sensor_ms(t, **sensor), t + late)
    return clock


TIMES = np.arange(0, 120, 0.1)


def test_the_stamp_is_that_of_step_0():
    assert np.abs(run(SensorClock(), TIMES[:50])).max() <= 0.001


@pytest.mark.parametrize("skew", [0.0, 0.004, -0.004, 0.009])
def test_late_arrivals_and_skew(skew):
    rng = np.random.default_rng(0)
    delays = rng.exponential(0.01, len(TIMES))
    clock = anchored(start=1000.0, skew=skew)
    error = run(clock, TIMES, delay=lambda i: delays[i], start=1000.0, skew=skew)
    # Until the skew is known it adds up from the time mode on: 2.3 s.
    assert np.abs(error[:25]).max() < 0.004 + 2.6 * abs(skew)
    assert np.abs(error[50:]).max() < 0.006
    assert abs(clock.latency - LATENCY) < 0.005


def test_the_wrap_of_the_timer_is_not_seen():
    error = run(anchored(start=16777.216 - 30.0), TIMES[:900], start=16777.216 - 30.0)
    assert np.abs(error).max() <= 0.002


def test_the_latency_is_learnt_from_the_time_mode():
    clock = anchored(latency=0.2)
    error = run(clock, TIMES[:30])
    assert clock.latency == pytest.approx(LATENCY, abs=0.002)
    assert np.abs(error).max() < 0.003


def test_a_first_stall_does_not_falsify_the_stamps():
    clock = anchored()
    stall = np.maximum(0.0, 0.7 - TIMES)
    error = run(clock, TIMES[:60], delay=lambda i: stall[i])
    assert np.abs(error).max() < 0.003
    assert LATENCIES[0] < clock.latency < LATENCIES[1]


def test_a_stall_later_on_is_let_through():
    clock = SensorClock()
    stall = np.where((TIMES > 50) & (TIMES < 51.2), 51.2 - TIMES, 0.0)
    error = run(clock, TIMES[:700], delay=lambda i: stall[i])
    assert np.abs(error).max() < 0.002


@pytest.mark.parametrize("jump_ms", [-1, -100, -5000, 200, 1_000_000, 8_000_000])
def test_a_time_that_cannot_be_is_refused_and_forgotten(jump_ms):
    clock = SensorClock()
    run(clock, TIMES[:30])
    with pytest.raises(ProtocolError, match="does not fit"):
        clock.stamp((sensor_ms(2.9) + jump_ms) % (1 << 24), 3.0 + LATENCY)
    assert np.abs(run(clock, TIMES[31:60])).max() <= 0.002


def test_a_timer_that_was_reset_is_believed_after_three_scans():
    clock = anchored()
    run(clock, TIMES[:300])
    refused = 0
    stamps = []
    for t in TIMES[300:310]:
        try:
            stamps.append(clock.stamp(sensor_ms(t - 30.0), t + LATENCY) - t)
        except ProtocolError:
            refused += 1
    assert refused == 2
    assert np.abs(stamps).max() < 0.002


def test_the_first_scan_must_fit_the_time_mode():
    clock = anchored()
    with pytest.raises(ProtocolError):
        clock.stamp(sensor_ms(5.0), 0.1 + LATENCY)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_scan_without_a_time_is_timed_by_the_turns_since_the_last(turns):
    clock = anchored()
    run(clock, TIMES[:50])
    t = TIMES[49] + turns * 0.1
    assert clock.stamp_by_turns(t + LATENCY + 0.004, 0.1) == pytest.approx(t, abs=0.0015)


@pytest.mark.parametrize("late", [0.04, 0.06, 0.35])
def test_a_scan_without_a_time_whose_turn_is_not_clear_is_refused(late):
    clock = anchored()
    with pytest.raises(ProtocolError, match="nor has any before"):
        clock.stamp_by_turns(LATENCY, 0.1)
    run(clock, TIMES[:50])
    with pytest.raises(ProtocolError, match="turns after the one before"):
        clock.stamp_by_turns(TIMES[49] + late + LATENCY, 0.1)


def test_a_scan_whose_arrival_is_late_does_not_move_the_others():
    clock = anchored()
    run(clock, TIMES[:50])
    for k in range(50, 90):
        stamp = clock.stamp_late(sensor_ms(TIMES[k]), TIMES[k] + LATENCY + 0.18)
        assert stamp == pytest.approx(TIMES[k], abs=0.0015)
    assert np.abs(run(clock, TIMES[90:200])).max() <= 0.0015
    with pytest.raises(ProtocolError, match="does not fit"):
        clock.stamp_late(sensor_ms(TIMES[200] + 3.0), TIMES[200] + LATENCY + 0.18)


def test_before_any_other_scan_a_late_one_is_refused():
    with pytest.raises(ProtocolError, match="nor is a scan before it"):
        SensorClock().stamp_late(1000, 1.0)
