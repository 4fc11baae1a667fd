"""The noise of readings seen frontally, of sweeps with known noise."""

import math

import numpy as np
import pytest
from synthetic import Box, irregular, observe

from scan3d_twin.core.registration.surfels.grid import extract_surfels
from scan3d_twin.core.registration.surfels.reading_noise import measure_reading_noise
from scan3d_twin.core.types import Pose2

AHEAD = (Box((1.2, -1.0, 0.0), (1.6, 1.0, 1.5)),)
FAR = (Box((3.2, -2.0, 0.0), (3.6, 2.0, 1.5)),)


def noise_of(boxes, sigma, yaw=0.0, seed=0, **changes):
    """Return the noise found in a sweep of ``boxes`` from the origin [m]."""
    rng = np.random.default_rng(seed)
    seen = observe(Pose2(0.0, 0.0, yaw), boxes, room=False, sigma=sigma, rng=rng, **changes)
    return measure_reading_noise(extract_surfels(seen.image))


@pytest.mark.parametrize("sigma", [0.003, 0.006])
def test_the_noise_of_a_wall_seen_frontally_is_found(sigma):
    assert noise_of(AHEAD, sigma) == pytest.approx(sigma, rel=0.06)


def test_what_is_far_away_or_seen_flatly_does_not_tell():
    assert math.isnan(noise_of(FAR, 0.003))
    assert math.isnan(noise_of(AHEAD, 0.003, yaw=1.0))


def test_lines_with_beams_of_their_own_do_not_tell():
    assert math.isnan(noise_of(AHEAD, 0.003, shift=irregular))


def test_lines_far_apart_show_the_shape_of_things_and_do_not_tell():
    assert math.isnan(noise_of(AHEAD, 0.003, step=math.radians(2.0)))
    assert noise_of(AHEAD, 0.003, step=math.radians(1.2)) == pytest.approx(0.003, rel=0.1)
