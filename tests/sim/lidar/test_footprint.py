"""The beam's width: what a footprint over a depth edge reads."""

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.types import VALID
from scan3d_twin.devices.urg import model as urg04lx
from scan3d_twin.devices.urg.device import URG04LX
from scan3d_twin.sim.config import IDEAL_ROBOT, LidarModelConfig, TwinConfig
from scan3d_twin.sim.lidar.config import IDEAL_LIDAR
from scan3d_twin.sim.lidar.footprint import MIN_EDGE_DEPTH, mix, offsets
from scan3d_twin.sim.robot import open_sim

FIVE = LidarModelConfig(sub_rays=5)


def mixed(distances, power):
    result = mix(np.array(distances)[:, None], np.array(power)[:, None], FIVE, URG04LX.sensor)
    return float(result.distances[0]), float(result.power[0]), result.codes


@pytest.mark.parametrize("count", [1, 3, 5, 9])
def test_sub_rays_have_the_second_moments_of_the_ellipse(count):
    angles = offsets(LidarModelConfig(sub_rays=count))
    assert angles.shape == (count, 2)
    assert np.all(angles[0] == 0)
    assert angles.mean(axis=0) == pytest.approx([0, 0], abs=1e-12)
    if count > 3:
        moments = (angles**2).mean(axis=0)
        assert moments == pytest.approx([0.0045**2 / 4, 0.0035**2 / 4], rel=1e-6)


def test_one_surface_reads_its_power_weighted_mean():
    distance, power, codes = mixed([1.0, 1.001, 0.999, 1.002, 0.998], [0.3] * 5)
    assert distance == pytest.approx(1.0)
    assert power == pytest.approx(0.3)
    assert len(codes) == 0


def test_a_depth_edge_reads_between_the_two_surfaces():
    distance, power, codes = mixed([1.0] * 3 + [1.5] * 2, [0.3] * 3 + [0.14] * 2)
    assert 1.02 < distance < 1.48
    assert power < 0.3
    assert codes.tolist() == [VALID]


def test_phasors_and_the_mean_agree_below_the_edge_threshold():
    distances = np.linspace(1.0, 1.0 + 1.01 * MIN_EDGE_DEPTH, 5)
    by_phase, _, codes = mixed(distances, [0.3] * 5)
    assert len(codes) == 1
    assert by_phase == pytest.approx(distances.mean(), abs=2e-5)


def test_misses_add_nothing():
    distance, power, _ = mixed([1.0, np.inf, 1.0, 1.0, np.inf], [0.3, 0.0, 0.3, 0.3, 0.0])
    assert distance == pytest.approx(1.0)
    assert power == pytest.approx(0.3 * 3 / 5)


def test_waves_that_cancel_become_an_error_code():
    # Half a wave of the first modulation apart: 299792458 / (4 * 46.55e6) m.
    half = 299_792_458 / (4 * urg04lx.MODULATIONS[0])
    _, power, codes = mixed([1.0, 1.0, 1.0 + half, 1.0 + half, 1.0], [0.2, 0.2, 0.31, 0.29, 0.2])
    assert power < 0.02
    assert codes[0] in (urg04lx.NO_RETURN, urg04lx.AMPLITUDES_DIFFER)


STEP = (
    '<geom name="target" type="box" size=".05 .5 .5" pos="1.05 .5 .5"/>'
    '<geom name="wall" type="box" size=".05 3 3" pos="1.55 0 1"/>'
)


@pytest.mark.parametrize("rays", [1, 5])
def test_mixed_pixels_come_at_edges_only_and_only_of_wide_beams(scene_of, rays):
    lidar = replace(IDEAL_LIDAR, sub_rays=rays)
    far_from_truth, edges = 0, 0
    with open_sim(scene_of(STEP), 0, TwinConfig(lidar=lidar, errors=IDEAL_ROBOT)) as (robot, truth):
        robot.base.set_velocity(0.0, 0.1)
        for _ in range(60):
            line = robot.lidar.read_line(1.0)
            evidence = truth.evidence()
            level = np.abs(robot.lidar.spec.elevations) < 1.0
            valid = (line.codes == VALID) & level & np.isfinite(evidence.distances)
            off = valid & (np.abs(line.ranges - evidence.distances) > 0.03)
            far_from_truth += int(off.sum())
            # The lidar is .05 m ahead and .30 m up; the box's edges: y = 0, z = 1.
            hits = evidence.positions + evidence.distances[:, None] * evidence.directions
            at_edge = (np.abs(hits[:, 1]) < 0.02) | (np.abs(hits[:, 2] - 1.0) < 0.04)
            at_edge |= np.abs(hits[:, 2] - 1.37) < 0.04  # on the wall above the box's top
            at_edge |= np.abs(hits[:, 2]) < 0.01  # where wall and floor meet
            edges += int((off & at_edge).sum())
    if rays == 1:
        assert far_from_truth == 0
    else:
        assert far_from_truth > 20
        assert edges == far_from_truth
