import pytest


def test_now_never_runs_backwards(robot):
    times = []
    for seconds in (0.0, 0.001, 0.05, 0.0, 0.3):
        times.append(robot.clock.now())
        robot.clock.sleep(seconds)
    times.append(robot.clock.now())
    assert times == sorted(times)


@pytest.mark.parametrize("seconds", [0.003, 0.015, 0.1, 1.0])
def test_sleep_lets_at_least_and_about_the_time_pass(robot, seconds):
    before = robot.clock.now()
    robot.clock.sleep(seconds)
    passed = robot.clock.now() - before
    assert seconds - 1e-9 <= passed <= seconds + 0.02


def test_sleeping_not_at_all_or_less_takes_no_time(robot):
    before = robot.clock.now()
    robot.clock.sleep(0.0)
    robot.clock.sleep(-1.0)
    assert robot.clock.now() - before <= 0.02
