"""Cutting a stream of beams into lines, and taking lines apart into beams."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.core.errors import LinkTimeoutError
from scan3d_twin.core.line_grid import make_full_circle
from scan3d_twin.core.types import UNMEASURED, VALID, Beams, FloatArray, ScanLine
from scan3d_twin.devices.rotating import BeamReader, Revolutions, list_beams, to_elevation

PERIOD, RATE = 0.1, 4500.0
SPEC = make_full_circle(470, PERIOD, 0.02, 12.0)


def stream(seconds: float, speed: float = 1.0, start: float = 0.3) -> Beams:
    """Return what a lidar measures from angle ``start`` [rad] on, each range telling the time."""
    times = 7.0 + np.arange(round(seconds * RATE)) / RATE
    angles = start + math.tau * speed / PERIOD * (times - 7.0)
    return Beams(times, to_elevation(angles), times, np.full(len(times), VALID))


def cut(beams: Beams, sizes: list[int]) -> tuple[list[ScanLine], Revolutions]:
    """Return the lines of ``beams`` that arrive in packets of ``sizes``, over and over."""
    revolutions, lines, at, k = Revolutions(SPEC, PERIOD * RATE), [], 0, 0
    while at < len(beams):
        lines += revolutions.add(beams.select(slice(at, at + sizes[k % len(sizes)])))
        at, k = at + sizes[k % len(sizes)], k + 1
    return lines, revolutions


def measured(line: ScanLine) -> FloatArray:
    return np.flatnonzero(line.codes != UNMEASURED)


@settings(deadline=None, max_examples=12)
@given(
    st.floats(0.96, 1.04),
    st.floats(0.0, math.tau),
    st.lists(st.integers(1, 700), min_size=1, max_size=4),
)
def test_every_revolution_is_a_line_with_all_its_beams_as_they_are(
    speed: float, start: float, sizes: list[int]
) -> None:
    beams = stream(0.6, speed, start)
    lines, _ = cut(beams, sizes)
    assert len(lines) >= 3
    counts = [len(measured(line)) for line in lines]
    assert max(abs(n - PERIOD / speed * RATE) for n in counts) <= 1
    for line in lines:
        at = measured(line)
        assert line.elevations is not None
        assert line.beam_times is not None
        # Ranges tell the time at which a beam was measured
        assert line.stamp + line.beam_times[at] == pytest.approx(line.ranges[at], abs=1e-9)
        angle = start + math.tau * speed / PERIOD * (line.ranges[at] - 7.0)
        assert np.allclose(to_elevation(angle - line.elevations[at]), 0.0, atol=1e-6)
        assert np.all(np.diff(line.elevations[at]) > 0)
        assert line.beam_times[at[0]] < 2 / RATE
    whole = np.concatenate([line.ranges[measured(line)] for line in lines])
    assert np.all(np.diff(whole) > 0)
    assert len(whole) >= len(beams) - 2.2 * PERIOD / speed * RATE


def test_the_stamp_is_when_the_seam_behind_was_passed() -> None:
    lines, _ = cut(stream(0.5, start=0.0), [12])
    assert [line.stamp for line in lines] == pytest.approx([7.05, 7.15, 7.25, 7.35], abs=1e-9)


def test_lost_packets_leave_places_without_a_beam() -> None:
    beams = stream(0.5)
    kept = np.ones(len(beams), dtype=bool)
    kept[1200:1212] = False
    lines, revolutions = cut(beams.select(kept), [12])
    assert (
        sum(len(measured(line)) for line in lines)
        == sum(len(measured(line)) for line in cut(beams, [12])[0]) - 12
    )
    assert revolutions.lost == 0


def test_the_lines_after_an_outage_are_whole_again() -> None:
    beams = stream(3.0)
    for first, last in ((900, 1100), (700, 1500), (450, 9000)):
        kept = np.ones(len(beams), dtype=bool)
        kept[first:last] = False
        lines, _ = cut(beams.select(kept), [12])
        stamps = np.array([line.stamp for line in lines])
        turns = np.diff(stamps) / PERIOD
        assert np.allclose(turns, np.rint(turns), atol=1e-3)
        assert len(lines) >= (len(beams) - (last - first)) / 450 - 4
        for line in lines:
            at = measured(line)
            assert line.beam_times is not None
            assert line.beam_times[at].min() >= -1e-9
            assert line.beam_times[at].max() <= PERIOD


def test_beams_that_lie_before_their_predecessors_stay_in_their_revolution() -> None:
    """A triangulating lidar shifts beams by their distance."""
    beams = stream(0.6)
    shift = np.radians(8.0) * (np.arange(len(beams)) % 7 == 3)
    jumping = Beams(beams.times, to_elevation(beams.elevations - shift), beams.ranges, beams.codes)
    lines, _ = cut(jumping, [40])
    for line in lines:
        at = measured(line)
        assert line.beam_times is not None
        assert np.ptp(line.beam_times[at]) < PERIOD + 0.0023
    assert len(lines) == 5


def test_a_line_comes_apart_into_its_beams() -> None:
    beams = stream(0.5)
    lines, _ = cut(beams, [12])

    class Waiting:
        spec = SPEC

        def read_line(self, timeout: float) -> ScanLine:
            if not lines:
                raise LinkTimeoutError("none")
            return lines.pop(0)

    again = list_beams(lines[1], SPEC)
    first = int(np.searchsorted(beams.times, again.times[0] - 1e-9))
    assert np.allclose(again.times, beams.times[first : first + len(again)])
    assert np.allclose(again.elevations, beams.elevations[first : first + len(again)])
    count = sum(len(measured(line)) for line in lines)
    assert len(BeamReader(Waiting()).read()) == count
    assert len(BeamReader(Waiting()).read()) == 0
