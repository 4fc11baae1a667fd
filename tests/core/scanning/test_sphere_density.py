import math

import numpy as np
import pytest

from scan3d_twin.core.scanning.sphere_density import SphereDensity, measure_density
from scan3d_twin.core.types import UNMEASURED, VALID, LidarSpec, RangeImage


def even_image(n_lines, n_beams, half=math.pi):
    """Lines over a part of the circle, beams at even steps of the sine of the elevation."""
    sines = (np.arange(n_beams) + 0.5) / n_beams * 2 - 1
    spec = LidarSpec(np.arcsin(sines), np.zeros(n_beams), 0.1, 0.02, 4.0)
    yaws = half - (np.arange(n_lines) + 0.5) / n_lines * 2 * half
    shape = (n_lines, n_beams)
    return RangeImage(
        np.zeros(n_lines), np.repeat(yaws[:, None], n_beams, axis=1), np.full(shape, np.nan),
        np.full(shape, 1), spec, np.eye(4),
    )  # fmt: skip


def test_readings_that_are_even_over_the_sphere_are_as_dense_everywhere():
    density = measure_density(even_image(144, 108))
    even = 144 * 108 / 41252.96
    assert density.seen == 1.0
    assert (density.low, density.median, density.high) == pytest.approx([even] * 3, rel=1e-5)


def test_half_a_turn_sees_half_of_the_sphere_as_densely():
    density = measure_density(even_image(72, 108, half=math.pi / 2))
    assert density.seen == pytest.approx(0.5, abs=0.02)
    assert density.median == pytest.approx(144 * 108 / 41252.96, rel=1e-5)


def test_what_no_beam_looked_into_does_not_count():
    image = even_image(144, 108)
    image.codes[:, 54:] = UNMEASURED
    image.codes[:, :54] = VALID
    assert measure_density(image).seen == pytest.approx(0.5)
    image.codes[:] = UNMEASURED
    assert measure_density(image) == SphereDensity(0.0, 0.0, 0.0, 0.0)
