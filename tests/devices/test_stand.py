"""The stand: a base without wheels and without a line."""

import pytest
from virtual import VirtualClock

from scan3d_twin.cli.commands.real import RealOptions, open_robot
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.types import Pose2
from scan3d_twin.devices.links.no_line import NoLine
from scan3d_twin.devices.registry import Devices, base_device
from scan3d_twin.real.robot import open_real


@pytest.fixture
def clock():
    return VirtualClock()


@pytest.fixture
def stand(clock):
    return base_device("stand").open_driver(NoLine(), clock, None)


def test_its_odometry_is_the_identity_in_samples_of_the_past(clock, stand):
    clock.sleep(0.505)
    samples = stand.odometry_since(0.1)
    period = stand.spec.sample_period
    assert [each.stamp for each in samples] == pytest.approx([k * period for k in range(5, 26)])
    assert all(each.T_odom_base == Pose2() for each in samples)
    assert samples[-1].stamp == stand.odometry().stamp <= clock.now()
    assert [each.stamp for each in stand.odometry_since(9.0)] == [stand.odometry().stamp]


def test_it_stands_and_does_not_drive(stand):
    assert stand.set_velocity(0.0, 0.0) == (0.0, 0.0)
    with pytest.raises(ConfigError, match=r"a stand does not drive, got 0.1 m/s"):
        stand.set_velocity(0.1, 0.0)
    assert stand.hazards().active() == ()


def test_it_has_neither_port_nor_emulator():
    with pytest.raises(ConfigError, match="a stand has no serial line"):
        base_device("stand").emulate(None)
    devices = Devices("stand", is_base_stated=True)
    options = RealOptions(robot="stand", port="/dev/null", lidar_port="/dev/zero")
    with pytest.raises(ConfigError, match="a stand has no port"), open_robot(options, devices):
        pass


def test_a_base_with_a_line_needs_its_port():
    with pytest.raises(ConfigError, match="create2 has a port"), open_real(None, "/dev/null"):
        pass
