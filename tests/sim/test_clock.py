import pytest

from scan3d_twin.sim.robot import open_sim


@pytest.mark.parametrize(
    ("seconds", "passed"), [(0.1, 0.1), (0.002, 0.002), (0.015, 0.016), (0.0, 0.0), (1e-6, 0.002)]
)
def test_sleep_rounds_up_to_physics_steps(bare, seconds, passed):
    with open_sim(bare, 0) as (robot, _):
        robot.clock.sleep(0.33)
        before = robot.clock.now()
        robot.clock.sleep(seconds)
        assert robot.clock.now() - before == pytest.approx(passed, abs=1e-9)


def test_time_does_not_drift_over_many_steps(bare):
    with open_sim(bare, 0) as (robot, _):
        for _ in range(500):
            robot.clock.sleep(0.01)
        assert robot.clock.now() == pytest.approx(5.0, abs=1e-9)
