"""Lines of the hardware interface; angles and times are those of the URG-04LX's data sheet."""

import numpy as np
import pytest

from scan3d_twin.core.types import VALID
from scan3d_twin.devices.urg.codec import ScanRequest
from scan3d_twin.devices.urg.lines import line_spec, link_spec, to_line
from scan3d_twin.devices.urg.model import LINKS
from scan3d_twin.devices.urg.scan_modes import scan_requests


def test_the_geometry_of_the_whole_scan():
    spec = line_spec(ScanRequest("MD", 44, 725))
    assert spec.n_beams == 682
    assert np.degrees(spec.elevations[[0, 340, 681]]) == pytest.approx([-119.53125, 0, 119.8828125])
    assert 1e3 * spec.beam_times[[0, 340, 681]] == pytest.approx([4.296875, 37.5, 70.80078125])
    assert (spec.min_range, spec.max_range, spec.line_period) == (0.020, 4.095, 0.1)


def test_a_cluster_is_at_its_middle():
    spec = line_spec(ScanRequest("MD", 383, 387, cluster=2, skip=1))
    assert np.degrees(spec.elevations) == pytest.approx(np.array([-0.5, 1.5, 3]) * 0.3515625)
    assert 1e3 * spec.beam_times == pytest.approx(np.array([383.5, 385.5, 387]) / 10.24)
    assert spec.line_period == pytest.approx(0.2)


@pytest.mark.parametrize("link", LINKS)
def test_driver_and_twin_agree(link):
    real, twin = line_spec(scan_requests(LINKS[link])[0]), link_spec(link)
    assert np.allclose(real.elevations, twin.elevations)
    assert np.allclose(real.beam_times, twin.beam_times)
    assert real.line_period == pytest.approx(twin.line_period)
    assert (real.min_range, real.max_range) == (twin.min_range, twin.max_range)


def test_codes_are_no_distances_and_distances_no_codes():
    line = to_line(1.5, np.array([0, 19, 20, 4095, 4096]))
    assert line.stamp == 1.5
    assert line.codes.tolist() == [0, 19, VALID, VALID, 0]
    assert line.ranges[2:4].tolist() == [0.020, 4.095]
    assert np.isnan(line.ranges[[0, 1, 4]]).all()
    with pytest.raises(ValueError, match="read-only"):
        line.ranges[0] = 1.0
