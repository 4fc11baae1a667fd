"""``twin emulate``: the twin's devices on serial ports, for this program's drivers and others."""

from __future__ import annotations

import json as json_module
import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock
    from scan3d_twin.devices.device import LidarDevice, Wiring
    from scan3d_twin.devices.links.line_model import Line
    from scan3d_twin.devices.links.serve import Port

NICENESS = -10
"""Scheduling priority of the emulator, -20 (first) to 19; assumption."""


@dataclass(frozen=True, kw_only=True)
class EmulateOptions:
    """What is emulated."""

    scene: str = "three_boxes"
    """Name of a scene (`twin scenes`), or an .xml, .stl, .ply, .obj or .glb file."""
    robot: Annotated[str, Parameter(name=("--robot", "--base"))] = DEFAULT_BASE
    """Name of the base, see `twin devices`."""
    lidar: str = DEFAULT_LIDAR
    """Name of the lidar, see `twin devices`."""
    lidar_cable: Literal["usb", "serial"] = "usb"
    """How the lidar is connected: over usb bit rates do not matter, over serial they do."""
    lidar_baud: int | None = None
    """Bit rate of the lidar when powered up (default: the lidar's own)."""
    lidar_protocol: Annotated[str | None, Parameter(name=("--lidar-protocol", "--scip"))] = None
    """Protocol of the lidar when powered up (default: the lidar's own)."""
    corrupt: Annotated[float, Parameter(allow_leading_hyphen=True)] = 0.0
    """Probability of losing a byte, of inserting one and of altering one, 0 to 0.1."""
    seed: int = 0
    """Seed of the robot's errors, the lidar's noise and the faults of the lines."""
    tcp: bool = False
    """Serve on TCP ports (`socket://HOST:PORT`) instead of pseudo-terminals."""
    json: bool = False
    """Print one line of JSON with base_port and lidar_port."""


def emulate(*, options: Annotated[EmulateOptions, Parameter(name="*")] = EmulateOptions()) -> None:
    """Serve the twin's base and lidar on two serial ports, until Ctrl-C.

    Raises:
        TwinError: There is no such scene, or an option has no such value.
    """
    from scan3d_twin.devices.links.serve import serve

    # Ctrl-C is how this is meant to end.
    with suppress(KeyboardInterrupt), ports(options) as (clock, base, lidar):
        if options.json:
            line = json_module.dumps({"base_port": base.path, "lidar_port": lidar.path})
        else:
            line = f"twin real --port {base.path} --lidar-port {lidar.path}{_devices(options)}"
        print(line, flush=True)
        _raise_priority()
        serve([base, lidar], clock)


def _devices(options: EmulateOptions) -> str:
    """Return the options of ``twin real`` that name the devices, as far as they are needed."""
    robot = "" if options.robot == DEFAULT_BASE else f" --robot {options.robot}"
    return robot if options.lidar == DEFAULT_LIDAR else f"{robot} --lidar {options.lidar}"


def _raise_priority() -> None:
    """Run before other programs where that is permitted: a real device is never busy elsewhere."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


def _wiring(options: EmulateOptions, lidar: LidarDevice) -> Wiring:
    """Return how the emulated ``lidar`` is connected and powered up."""
    from scan3d_twin.devices.device import Wiring

    stated = (
        ("--lidar-baud", options.lidar_baud, lidar.bauds),
        ("--lidar-protocol", options.lidar_protocol, lidar.protocols),
    )
    for name, value, choices in stated:
        if value is not None and value not in choices:
            known = ", ".join(map(str, choices)) or f"left out for {lidar.name}"
            raise ConfigError(f"{name} must be one of {known}, got {value}")
    return Wiring(options.lidar_cable == "usb", options.lidar_baud, options.lidar_protocol)


@contextmanager
def ports(options: EmulateOptions) -> Iterator[tuple[Clock, Port, Port]]:
    """Open the twin and its two ports; yields its clock, the base's port and the lidar's.

    Raises:
        TwinError: See ``emulate``.
    """
    from scan3d_twin.devices.links.line_model import Faults, Line
    from scan3d_twin.devices.links.pty import PtyPort
    from scan3d_twin.devices.links.tcp import TcpPort
    from scan3d_twin.devices.registry import base_device, lidar_device
    from scan3d_twin.sim.config import DEFAULT_WORLD, TwinConfig
    from scan3d_twin.sim.robot import open_robot

    base_model, lidar_model = base_device(options.robot), lidar_device(options.lidar)
    wiring = _wiring(options, lidar_model)
    if not 0 <= options.corrupt <= 0.1:
        raise ConfigError(f"--corrupt must be within 0 and 0.1, got {options.corrupt:g}")
    p = options.corrupt
    faults = Faults(drop=p, insert=p, flip=p)
    config = TwinConfig.of(DEFAULT_WORLD, options.robot, options.lidar, lidar_model.links[0])
    config = replace(config, errors=replace(config.errors, reckoning="wheels"))

    def port(line: Line) -> PtyPort | TcpPort:
        opened = TcpPort(line) if options.tcp else PtyPort(line)
        return stack.enter_context(closing(opened))

    with open_robot(options.scene, options.seed, config) as robot, ExitStack() as stack:
        base = port(Line(base_model.emulate(robot.base), faults, options.seed))
        lidar = port(Line(lidar_model.emulate(robot.lidar, wiring), faults, options.seed + 1))
        yield robot.clock, base, lidar
