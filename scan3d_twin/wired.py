"""The real drivers, connected to emulated devices on the twin; one process, virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.hal import Clock, Robot
from scan3d_twin.devices.device import Wiring
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.links.no_line import NoLine
from scan3d_twin.devices.registry import (
    base_device,
    lidar_device,
    turntable_device,
    turntable_names,
)
from scan3d_twin.real.robot import CarriedTurntable, open_over
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.truth import Truth

EMULATED_TURNTABLE = "xl330"
"""Turntable whose bytes stand for one of the twin that is no device, such as ``ideal``."""


class HazardFreeClock:
    """The twin's clock for emulators: hazards reach the drivers as bytes, not as exceptions."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.now = clock.now

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``; never raises ``HazardError``."""
        deadline = self._clock.now() + seconds
        while (left := deadline - self._clock.now()) > 1e-9:
            with suppress(HazardError):
                self._clock.sleep(left)


@contextmanager
def open_wired(
    scene: Scene | str, seed: int, config: TwinConfig | None = None
) -> Iterator[tuple[Robot, Truth]]:
    """Open the twin like ``open_sim``, but behind the real drivers and emulated devices.

    Time 0 is when the twin comes to rest. The drivers then take about a second to connect, and the
    odometry starts as the identity. The same seed gives bit-identical readings.

    Raises:
        ConfigError, SceneError: See ``open_sim``.
        LinkError: The lidar's link cannot carry the lines asked for.
    """
    config = TwinConfig() if config is None else config
    with open_sim(scene, seed, config) as (twin, truth):
        # Emulate the devices
        clock = HazardFreeClock(twin.clock)
        own_base = base_device(config.robot)
        is_stand = own_base.spec.is_stand
        base_link = NoLine() if is_stand else Wire(own_base.emulate(twin.base), clock)
        device = lidar_device(config.lidar_model)
        wiring = Wiring(usb=config.lidar_link in device.usb_links)
        lidar = device.emulate(twin.lidar, wiring)

        # Connect the drivers
        links = base_link, lambda: Wire(lidar, clock)
        carried = _emulate_turntable(twin, clock, config.turntable)
        with open_over(*links, clock, config.devices, None, carried) as robot:
            yield replace(robot, T_base_lidar=twin.T_base_lidar), truth


def _emulate_turntable(twin: Robot, clock: Clock, name: str) -> CarriedTurntable | None:
    """Return the emulated turntable of the ``twin`` and where it is; None if there is none."""
    if twin.turntable is None or twin.T_base_axis is None:
        return None
    name = name if name in turntable_names() else EMULATED_TURNTABLE
    device = turntable_device(name).emulate(twin.turntable)
    mount = twin.T_base_axis, twin.T_base_lidar
    return CarriedTurntable(name, lambda: Wire(device, clock), *mount)
