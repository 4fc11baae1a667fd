from __future__ import annotations

import math

import pytest

from scan3d_twin.cli.keeper import Odometer
from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.motion import drive_to, turn_by
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim


def test_the_way_is_the_same_however_often_it_is_read() -> None:
    with open_sim("three_boxes", 0, TwinConfig.ideal()) as (robot, _):
        often, once = Odometer(robot.base), Odometer(robot.base)
        for k in range(4):
            turn_by(robot, math.pi / 2, MotionConfig())
            drive_to(robot, 0.1 * (k % 2 + 1), 0.1 * k, MotionConfig())
            often.read()
            often.read()
        once.read()
    assert often.path == pytest.approx(once.path, abs=1e-9)
    assert often.turn == pytest.approx(once.turn, abs=1e-9)
    assert often.path > 0.4
    assert often.turn > 4 * math.pi / 2
