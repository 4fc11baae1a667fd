"""Description of the stand for the device registry; it has no line to speak on."""

from __future__ import annotations

from typing import Any

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.devices.stand import model

MAX_RADIUS = 0.17
"""What is left of the sweep around a stand [m]: its foot and what carries the lidar."""


def open_stand(*_: Any) -> Any:
    """Refuse to open a stand on a line.

    Raises:
        ConfigError: Always.
    """
    raise ConfigError("a stand has no serial line: its lidar and turntable alone are connected")


STAND = BaseDevice(
    name="stand",
    summary="Stand without wheels: a turntable turns the lidar",
    spec=model.STAND,
    open_driver=open_stand,
    emulate=open_stand,
    options={"motion": {"robot_radius": MAX_RADIUS}},
)
