"""The lidar is unplugged in the middle of a sweep of the twin, and plugged in again."""

import numpy as np
import pytest

from scan3d_twin.core.config import Config
from scan3d_twin.core.sweep import sweep
from scan3d_twin.emulator.create import CreateEmulator
from scan3d_twin.emulator.line import Line, Wire
from scan3d_twin.emulator.urg import UrgEmulator
from scan3d_twin.emulator.urg_profile import UrgProfile
from scan3d_twin.protocols.urg04lx import LINKS
from scan3d_twin.real.robot import open_over
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import Unhindered


class Accident(Unhindered):
    """A clock at whose will the lidar's plug is out."""

    def __init__(self, clock, line, seconds):
        super().__init__(clock)
        self.line, self.seconds, self.out = line, seconds, None

    def sleep(self, seconds):
        super().sleep(seconds)
        if self.out is not None:
            self.line.plugged = not 0.0 <= self.now() - self.out < self.seconds


@pytest.mark.parametrize(
    ("profile", "link"),
    [(UrgProfile(), "usb"), (UrgProfile(usb=False, baud=19200, scip1=True), "115200")],
)
def test_the_sweep_is_completed_and_nothing_is_lost(profile, link):
    config = Config()
    with open_sim("plain_wall", 3, TwinConfig(lidar_link=link)) as (twin, _):
        line = Line(UrgEmulator(twin.lidar, profile))
        clock = Accident(twin.clock, line, seconds=0.8)
        base = Wire(CreateEmulator(twin.base), clock)
        with open_over(base, lambda: Wire(line, clock), clock, LINKS[link]) as robot:
            stamps = []

            def on_line(scan):
                stamps.append(scan.stamp)
                if len(stamps) == 40:
                    clock.out = clock.now()

            image = sweep(robot, 0.0, config, on_line).image
            assert robot.lidar.stats.reconnects == 1
    assert np.diff(stamps).max() > 0.8
    yaws = image.yaws[:, image.yaws.shape[1] // 2]
    spacing = config.sweep.yaw_rate * robot.lidar.spec.line_period
    assert -np.diff(yaws).min() < 1.6 * spacing
    assert yaws[0] - yaws[-1] == pytest.approx(config.sweep.width, abs=2 * spacing)
