"""``twin emulate``: the twin's devices on serial ports, for this program's drivers and others."""

from __future__ import annotations

import json as json_module
import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock
    from scan3d_twin.devices.device import LidarDevice, Wiring
    from scan3d_twin.devices.links.line_model import Device
    from scan3d_twin.devices.links.serve import Port

NICENESS = -10
"""Scheduling priority of the emulator, -20 (first) to 19; assumption."""
ADAPTER_LATENCY = 0.0015
"""Time that a USB serial adapter adds to a reply [s]; assumption: it is polled every 1 ms, and
holds bytes back for 1 ms or more. A client that flushes its input right after it has written loses
no reply."""


@dataclass(frozen=True, kw_only=True)
class EmulateOptions:
    """What is emulated."""

    scene: str = "three_boxes"
    """Name of a scene (`twin scenes`), or an .xml, .stl, .ply, .obj or .glb file."""
    mesh_scale: float = 1.0
    """Metres per unit of a mesh file."""
    mesh_up: str = "auto"
    """Axis of a mesh file that is up: y, z or auto."""
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
    tcp_base_port: int | None = None
    """Number of the base's TCP port (default: any that is free); implies --tcp."""
    tcp_lidar_port: int | None = None
    """Number of the lidar's TCP port (default: any that is free); implies --tcp."""
    link: Path | None = None
    """Folder for the links `base` and `lidar` to the terminals, whose own names change."""
    json: bool = False
    """Print one line of JSON with base_port and lidar_port."""


def emulate(*, options: Annotated[EmulateOptions, Parameter(name="*")] = EmulateOptions()) -> None:
    """Serve the twin's base and lidar on two serial ports, until Ctrl-C.

    Raises:
        TwinError: There is no such scene, or an option has no such value.
    """
    from scan3d_twin.devices.links.serve import serve

    # Ctrl-C is how this is meant to end.
    with (
        suppress(KeyboardInterrupt),
        ports(options) as (clock, base, lidar),
        _named(options.link, base, lidar) as (base_path, lidar_path),
    ):
        if options.json:
            line = json_module.dumps({"base_port": base_path, "lidar_port": lidar_path})
        else:
            line = f"twin real --port {base_path} --lidar-port {lidar_path}{_devices(options)}"
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


@contextmanager
def _named(folder: Path | None, base: Port, lidar: Port) -> Iterator[tuple[str, str]]:
    """Yield the paths of the ports for their clients: links in ``folder`` if there is one.

    Raises:
        FileError: The links cannot be made.
    """
    if folder is None:
        yield base.path, lidar.path
        return
    from scan3d_twin.devices.links.pty import linked

    with (
        linked(base.path, folder / "base") as first,
        linked(lidar.path, folder / "lidar") as second,
    ):
        yield str(first), str(second)


def _tcp_ports(options: EmulateOptions) -> tuple[int, int] | None:
    """Return the numbers of the TCP ports of base and lidar, 0 for any; None without TCP.

    Raises:
        ConfigError: A number is out of range, or links to TCP ports are wanted.
    """
    stated = {
        "--tcp-base-port": options.tcp_base_port,
        "--tcp-lidar-port": options.tcp_lidar_port,
    }
    for name, number in stated.items():
        if number is not None and not 1 <= number <= 65535:
            raise ConfigError(f"{name} must be within 1 and 65535, got {number}")
    if not options.tcp and not any(stated.values()):
        return None
    if options.link is not None:
        raise ConfigError("--link names terminals; TCP ports have numbers: --tcp-base-port")
    return options.tcp_base_port or 0, options.tcp_lidar_port or 0


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
    from scan3d_twin.sim.scenes.load import load_scene

    base_model, lidar_model = base_device(options.robot), lidar_device(options.lidar)
    wiring = _wiring(options, lidar_model)
    if not 0 <= options.corrupt <= 0.1:
        raise ConfigError(f"--corrupt must be within 0 and 0.1, got {options.corrupt:g}")
    p = options.corrupt
    faults = Faults(drop=p, insert=p, flip=p)
    config = TwinConfig.of(DEFAULT_WORLD, options.robot, options.lidar, lidar_model.links[0])
    config = replace(config, errors=replace(config.errors, reckoning="wheels"))

    numbers = _tcp_ports(options)

    def port(device: Device, index: int) -> PtyPort | TcpPort:
        line = Line(device, faults, options.seed + index, ADAPTER_LATENCY)
        opened = PtyPort(line) if numbers is None else TcpPort(line, port=numbers[index])
        return stack.enter_context(closing(opened))

    scene = load_scene(options.scene, options.mesh_scale, mesh_up=options.mesh_up)
    with open_robot(scene, options.seed, config) as robot, ExitStack() as stack:
        base = port(base_model.emulate(robot.base), 0)
        lidar = port(lidar_model.emulate(robot.lidar, wiring), 1)
        yield robot.clock, base, lidar
