import math
import time

import pytest

from scan3d_twin.real.clock import RealClock


def test_it_starts_at_zero_and_runs_with_the_systems_clock():
    before = time.monotonic()
    clock = RealClock()
    first = clock.now()
    assert 0.0 <= first <= time.monotonic() - before
    clock.sleep(0.02)
    assert clock.now() >= first + 0.02
    assert clock.now() <= time.monotonic() - before


@pytest.mark.parametrize("seconds", [0.0, -1.0, -math.inf])
def test_nobody_waits_for_a_time_that_has_passed(seconds):
    clock = RealClock()
    clock.sleep(seconds)
    assert clock.now() >= 0.0
