"""The real drivers, connected to emulated devices on the twin; one process, virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress

from scan3d_twin.core.errors import ConfigError, HazardError
from scan3d_twin.core.hal import Clock, Robot
from scan3d_twin.devices.device import Wiring
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.registry import base_device, lidar_device
from scan3d_twin.real.robot import open_over
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.truth import Truth


def refuse_turntable(config: TwinConfig, reason: str) -> None:
    """Refuse a twin with a turntable, for a ``reason``.

    Raises:
        ConfigError: It has one.
    """
    if config.pattern != "yaw-base":
        raise ConfigError(f"--pattern {config.pattern} needs a turntable, and {reason}")


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
    refuse_turntable(config, "the emulated devices have none")
    with open_sim(scene, seed, config) as (twin, truth):
        # Emulate the devices
        clock = HazardFreeClock(twin.clock)
        base = base_device(config.robot).emulate(twin.base)
        device = lidar_device(config.lidar_model)
        wiring = Wiring(usb=config.lidar_link in device.usb_links)
        lidar = device.emulate(twin.lidar, wiring)

        # Connect the drivers
        links = Wire(base, clock), lambda: Wire(lidar, clock)
        with open_over(*links, clock, config.devices) as robot:
            yield robot, truth
