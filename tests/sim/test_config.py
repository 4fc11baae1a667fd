import subprocess
import sys

import pytest

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.sim.config import (
    IDEAL_LIDAR,
    IDEAL_ROBOT,
    LidarModelConfig,
    RobotErrorConfig,
    TwinConfig,
)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("line_loss", -0.1),
        ("line_loss", 1.0),
        ("sigma", -0.001),
        ("sigma", float("nan")),
        ("sigma_per_metre", -1.0),
        ("sigma_weak", -1.0),
        ("bias", float("inf")),
        ("albedo", 1.2),
        ("roughness", 0.0),
        ("threshold", -1.0),
        ("softness", 0.0),
        ("sub_rays", 0),
    ],
)
def test_a_lidar_value_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(ConfigError, match=rf"lidar\.{name} must be"):
        LidarModelConfig(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("wheel_radius", -0.1),
        ("wheel_radius", 0.06),
        ("wheel_base", 0.2),
        ("cogging", 1.0),
        ("friction_min", 0.0),
        ("friction_max", 0.4),
    ],
)
def test_a_robot_error_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(ConfigError, match=rf"errors\.{name}"):
        RobotErrorConfig(**{name: value})


def test_an_unknown_link_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match=r"'9600'; known: 115200, 115200-full, usb"):
        TwinConfig(lidar_link="9600")


def test_an_unknown_robot_is_refused():
    with pytest.raises(ConfigError, match="create9"):
        TwinConfig(robot="create9")


def test_ideal_has_no_errors():
    assert TwinConfig.ideal() == TwinConfig(lidar=IDEAL_LIDAR, errors=IDEAL_ROBOT)
    assert TwinConfig.ideal("115200").lidar_link == "115200"
    assert (IDEAL_ROBOT.wheel_radius, IDEAL_ROBOT.wheel_base, IDEAL_ROBOT.cogging) == (0, 0, 0)


def test_importing_it_costs_nothing():
    code = (
        "import sys, scan3d_twin.sim.config, scan3d_twin.devices.urg.model\n"
        "print(sorted({'numpy', 'mujoco', 'trimesh', 'scipy'} & set(sys.modules)))"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert result.stdout.strip() == "[]"
