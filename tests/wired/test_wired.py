"""The real drivers on the emulated devices on the twin: as good as the twin itself."""

from dataclasses import replace

import pytest

from scan3d_twin.core.config import Config
from scan3d_twin.core.digitize import digitize
from scan3d_twin.core.evaluate import evaluate
from scan3d_twin.core.motion import turn_by
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.presets import preset
from scan3d_twin.recording.settings import settings
from scan3d_twin.recording.views import view_bytes
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import open_wired


def digitised(opener, link, config):
    with opener("three_boxes", 0, TwinConfig(lidar_link=link)) as (robot, truth):
        planner = make_planner(config.planner)
        session = digitize(robot, planner, config, 0, Unobserved())
        return session, evaluate(session, truth), robot.lidar


@pytest.mark.timeout(300)
@pytest.mark.parametrize("link", ["usb", "115200"])
def test_three_boxes_through_the_drivers_is_as_good_as_without(link):
    """With the preset ``best``; plain ICP differs more from run to run than the links do."""
    config = settings([{"tour": "front"}, preset("best")]).config
    sim, by_sim, _ = digitised(open_sim, link, config)
    wired, by_wired, lidar = digitised(open_wired, link, config)
    # The corner at the end of the row takes one view or three, as the noise has it.
    assert abs(len(wired.views) - len(sim.views)) <= 2
    assert wired.stop_reason == sim.stop_reason == "front complete"
    assert by_wired.coverage == pytest.approx(by_sim.coverage, abs=0.1)
    assert by_wired.accuracy.median == pytest.approx(by_sim.accuracy.median, abs=0.003)
    for evaluation in (by_sim, by_wired):
        assert max(pair.error for pair in evaluation.pairs) <= 0.010
    assert lidar.stats.bad == 0
    assert lidar.stats.reconnects == 0


def test_one_seed_gives_the_same_bytes():
    config = replace(Config(), max_views=2)
    first, second = (digitised(open_wired, "usb", config)[0] for _ in range(2))
    assert len(first.views) == 2
    assert [view_bytes(v) for v in first.views] == [view_bytes(v) for v in second.views]


@pytest.mark.parametrize("base", ["create1", "create2"])
def test_a_turn_through_the_drivers_ends_where_the_odometry_says(base):
    with open_wired("three_boxes", 3, replace(TwinConfig.ideal(), robot=base)) as (robot, truth):
        before = truth.pose_at(robot.clock.now())
        turn_by(robot, 1.5, Config().motion)
        robot.clock.sleep(0.6)
        turned = before.inverse() @ truth.pose_at(robot.clock.now())
        assert robot.base.odometry().T_odom_base.yaw == pytest.approx(turned.yaw, abs=0.03)
