"""Description of the stand for the device registry; it has no line to speak on."""

from __future__ import annotations

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import Clock, DriveBase
from scan3d_twin.devices.device import BaseDevice
from scan3d_twin.devices.links.guard import Guard
from scan3d_twin.devices.links.line_model import Device
from scan3d_twin.devices.links.transport import Transport
from scan3d_twin.devices.stand import model
from scan3d_twin.devices.stand.driver import Stand

MAX_RADIUS = 0.17
"""What is left of the sweep around a stand [m]: its foot and what carries the lidar."""


def open_stand(line: Transport, clock: Clock, guard: Guard | None) -> Stand:
    """Return the stand; it has no ``line``, and needs no ``guard``."""
    return Stand(clock)


def emulate_stand(base: DriveBase) -> Device:
    """Refuse to emulate a stand.

    Raises:
        ConfigError: Always.
    """
    raise ConfigError("a stand has no serial line: its lidar and turntable alone are connected")


STAND = BaseDevice(
    name="stand",
    summary="Stand without wheels: a turntable turns the lidar",
    spec=model.STAND,
    open_driver=open_stand,
    emulate=emulate_stand,
    options={"motion": {"robot_radius": MAX_RADIUS}},
)
