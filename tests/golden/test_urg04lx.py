"""Angles and steps quoted from the SCIP 2.0 specification and the URG-04LX data sheet."""

import pytest

from scan3d_twin.devices.urg import model as urg04lx


@pytest.mark.parametrize(
    ("step", "degrees"), [(384, 0.0), (44, -119.53125), (725, 119.8828125), (385, 0.3515625)]
)
def test_angle_of_a_step(step, degrees):
    assert urg04lx.step_angle(step) * 57.29577951308232 == pytest.approx(degrees, abs=1e-9)


@pytest.mark.parametrize(("step", "milliseconds"), [(0, 0.0), (384, 37.5), (512, 50.0)])
def test_time_of_a_step(step, milliseconds):
    assert urg04lx.step_time(step) * 1000 == pytest.approx(milliseconds)


@pytest.mark.parametrize(
    ("link", "first", "last", "count", "period"),
    [
        ("usb", 44, 725, 682, 0.1),
        ("115200", 206, 562, 357, 0.1),
        ("115200-full", 44, 725, 682, 0.2),
    ],
)
def test_link_table(link, first, last, count, period):
    mode = urg04lx.LINKS[link]
    assert (mode.steps[0], mode.steps[-1], len(mode.steps)) == (first, last, count)
    assert mode.line_period == pytest.approx(period)


def test_there_are_no_other_links():
    assert len(urg04lx.LINKS) == 3


def test_ranges_and_revolution():
    assert (urg04lx.MIN_RANGE_MM, urg04lx.MAX_RANGE_MM, urg04lx.TRUSTED_RANGE_MM) == (
        20,
        4095,
        4000,
    )
    assert urg04lx.REVOLUTION == 60 / 600
    assert urg04lx.STEPS_PER_TURN == 1024


@pytest.mark.parametrize(("link", "baud"), [("115200", 115200), ("115200-full", 115200)])
def test_a_line_fits_its_link(link, baud):
    # MD reply: three characters a step in blocks of 64 + sum + LF; about 25 bytes around it; 8N1.
    mode = urg04lx.LINKS[link]
    data = 3 * len(mode.steps)
    sent = data + 2 * -(-data // 64) + 25
    assert sent * 10 / baud <= mode.line_period + 0.002


def test_error_codes():
    """The table of the specification for the URG-04LX, and for 1 to 19 what users of it report."""
    codes = (urg04lx.NO_RETURN, urg04lx.WEAK_RETURN, urg04lx.TOO_FAR)
    assert codes == (0, 1, 6)
    assert (urg04lx.NEIGHBOURS_INVALID, urg04lx.AMPLITUDES_DIFFER) == (7, 8)
    assert (urg04lx.GLITCH, urg04lx.TOO_STRONG) == (10, 18)


def test_the_points_that_can_be_asked_for():
    assert (urg04lx.FIRST_STEP, urg04lx.LAST_STEP, urg04lx.LAST_POINT) == (44, 725, 768)


def test_the_phases_of_both_modulations_repeat_together_every_22_5_m():
    low, high = urg04lx.MODULATIONS
    assert (low, high) == (46.55e6, 53.2e6)
    assert 299_792_458 / (2 * (high - low)) == pytest.approx(22.54, abs=0.01)
    assert high / (high - low) == pytest.approx(8.0)


def test_replies_come_on_the_tick_of_the_capture():
    """Replies began 10.8, 110.8, ... 808.8 ms after the first request."""
    ticks = (10.8, 110.8, 211.0, 310.7, 409.8, 509.7, 609.8, 708.7, 808.8)
    assert (ticks[-1] - ticks[0]) / 8 == pytest.approx(1000 * urg04lx.COMMAND_TICK, abs=0.1)
    assert pytest.approx(0.101) == urg04lx.REPLY_LATENCY
