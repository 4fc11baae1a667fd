"""The real drivers on the emulated devices on the twin: as good as the twin itself."""

from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.navigation.motion_control import turn_by
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.recording.views import view_bytes
from scan3d_twin.run.settings import build_settings
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import open_wired


def digitised(opener, link, config, seed=0, start=0.0):
    """Return the session, its evaluation, the lidar and the time at which it began [s]."""
    with opener("three_boxes", seed, TwinConfig(lidar_link=link)) as (robot, truth):
        robot.clock.sleep(start - robot.clock.now())
        began = robot.clock.now()
        planner = make_planner(config.planner)
        session = run_loop(robot, planner, config, seed, Unobserved())
        return (
            session,
            evaluate(session, truth),
            robot.lidar,
            began,
        )


@pytest.mark.parametrize("link", ["usb", "115200"])
def test_three_boxes_through_the_drivers_is_as_good_as_without(link):
    """From the same instant on, so that both see the same noise; benchmarks/links.py has more."""
    config = build_settings([{"tour": "front"}, preset_options("best")]).config
    wired, by_wired, lidar, began = digitised(open_wired, link, config, seed=2)
    sim, by_sim, _, _ = digitised(open_sim, link, config, seed=2, start=began)
    assert abs(len(wired.views) - len(sim.views)) <= 1
    assert by_wired.coverage == pytest.approx(by_sim.coverage, abs=0.05)
    assert by_wired.accuracy.median == pytest.approx(by_sim.accuracy.median, abs=0.002)
    for evaluation in (by_sim, by_wired):
        assert max(pair.error for pair in evaluation.pairs) <= 0.010
    assert lidar.stats.bad == 0
    assert lidar.stats.reconnects == 0


@pytest.mark.parametrize(
    ("lidar", "link"),
    [
        *(("urg04lx", link) for link in ("usb", "115200", "115200-full")),
        *(("ld19", "230400"), ("rplidar_a1", "express")),
    ],
)
def test_a_sweep_through_the_drivers_has_the_headings_and_times_of_one_without(lidar, link):
    """What a line's place in the image rests on: stamps, odometry, and the turn between them."""
    twin = TwinConfig.of("ideal", lidar=lidar, lidar_link=link)
    errors = {}
    for opener in (open_sim, open_wired):
        with opener("three_boxes", 1, twin) as (robot, truth):
            start = truth.pose_at(robot.clock.now())
            image = sweep(robot, 0.3, paper_config(), lambda line: None).image
            front = image.yaws.shape[1] // 2
            stamps = image.stamps + image.spec.beam_times[front]
            true = [(start.inverse() @ truth.pose_at(float(t))).yaw for t in stamps]
            errors[opener] = np.degrees(image.yaws[:, front] + 0.3 - true)
            assert image.n_lines == pytest.approx(60 / 5 / image.spec.line_period, abs=5)
    # One encoder count is 0.108 deg of yaw.
    assert abs(errors[open_wired].mean() - errors[open_sim].mean()) < 0.05
    assert errors[open_wired].std() < errors[open_sim].std() + 0.02
    assert np.abs(errors[open_wired]).max() < 0.35


def test_one_seed_gives_the_same_bytes():
    config = replace(paper_config(), max_views=2)
    first, second = (digitised(open_wired, "usb", config)[0] for _ in range(2))
    assert len(first.views) == 2
    assert [view_bytes(v) for v in first.views] == [view_bytes(v) for v in second.views]


@pytest.mark.parametrize("base", ["create1", "create2"])
def test_a_turn_through_the_drivers_ends_where_the_odometry_says(base):
    with open_wired("three_boxes", 3, replace(TwinConfig.ideal(), robot=base)) as (robot, truth):
        before = truth.pose_at(robot.clock.now())
        turn_by(robot, 1.5, paper_config().motion)
        robot.clock.sleep(0.6)
        turned = before.inverse() @ truth.pose_at(robot.clock.now())
        assert robot.base.odometry().T_odom_base.yaw == pytest.approx(turned.yaw, abs=0.03)
