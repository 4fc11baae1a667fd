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

from scan3d_twin.cli.options import TURNTABLE_PATTERN, names_turntable
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock
    from scan3d_twin.devices.device import BaseDevice, LidarDevice, TurntableDevice, Wiring
    from scan3d_twin.devices.links.line_model import Device
    from scan3d_twin.devices.links.serve import Port
    from scan3d_twin.sim.config import TwinConfig

NICENESS = -10
"""Scheduling priority of the emulator, -20 (first) to 19; assumption."""
ADAPTER_LATENCY = 0.0015
"""Time that a USB serial adapter adds to a reply [s]; assumption: it is polled every 1 ms, and
holds bytes back for 1 ms or more. A client that flushes its input right after it has written loses
no reply."""


ROLES = ("base", "lidar", "turntable")
"""What is served, each on a port of its own."""


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
    turntable: str | None = None
    """Name of the turntable, see `twin devices`."""
    pattern: Literal["yaw", "pitch", "roll"] | None = None
    """How it turns the lidar (default: yaw)."""
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
    """Likewise of the lidar's."""
    tcp_turntable_port: int | None = None
    """Likewise of the turntable's."""
    link: Path | None = None
    """Folder for the links `base`, `lidar` and `turntable` to the terminals."""
    json: bool = False
    """Print one line of JSON with the ports."""


def emulate(*, options: Annotated[EmulateOptions, Parameter(name="*")] = EmulateOptions()) -> None:
    """Serve the twin's base, lidar and turntable on serial ports, until Ctrl-C.

    Raises:
        TwinError: There is no such scene, or an option has no such value.
    """
    from scan3d_twin.devices.links.serve import serve

    # Ctrl-C is how this is meant to end.
    with (
        suppress(KeyboardInterrupt),
        ports(options) as (clock, served),
        _named(options.link, served) as paths,
    ):
        print(_describe(options, paths), flush=True)
        _raise_priority()
        serve(list(served.values()), clock)


def _describe(options: EmulateOptions, paths: dict[str, str]) -> str:
    """Return the line that names the ports: JSON, or the command that uses them."""
    if options.json:
        return json_module.dumps({f"{role}_port": path for role, path in paths.items()})
    named = {"base": "--port", "lidar": "--lidar-port", "turntable": "--turntable-port"}
    given = " ".join(f"{named[role]} {path}" for role, path in paths.items())
    return f"twin real {given}{_devices(options)}"


def _devices(options: EmulateOptions) -> str:
    """Return the options of ``twin real`` that name the devices, as far as they are needed."""
    stated = {
        "--robot": None if options.robot == DEFAULT_BASE else options.robot,
        "--lidar": None if options.lidar == DEFAULT_LIDAR else options.lidar,
        "--turntable": options.turntable,
        "--pattern": options.pattern,
    }
    return "".join(f" {name} {value}" for name, value in stated.items() if value is not None)


def _raise_priority() -> None:
    """Run before other programs where that is permitted: a real device is never busy elsewhere."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


@contextmanager
def _named(folder: Path | None, served: dict[str, Port]) -> Iterator[dict[str, str]]:
    """Yield the paths of the ports for their clients: links in ``folder`` if there is one.

    Raises:
        FileError: The links cannot be made.
    """
    if folder is None:
        yield {role: port.path for role, port in served.items()}
        return
    from scan3d_twin.devices.links.pty import linked

    with ExitStack() as stack:
        yield {
            role: str(stack.enter_context(linked(port.path, folder / role)))
            for role, port in served.items()
        }


def _tcp_ports(options: EmulateOptions) -> dict[str, int] | None:
    """Return the numbers of the TCP ports, 0 for any; None without TCP.

    Raises:
        ConfigError: A number is out of range, or links to TCP ports are wanted.
    """
    stated = {
        "base": options.tcp_base_port,
        "lidar": options.tcp_lidar_port,
        "turntable": options.tcp_turntable_port,
    }
    for role, number in stated.items():
        if number is not None and not 1 <= number <= 65535:
            raise ConfigError(f"--tcp-{role}-port must be within 1 and 65535, got {number}")
    if not options.tcp and not any(stated.values()):
        return None
    if options.link is not None:
        raise ConfigError("--link names terminals; TCP ports have numbers: --tcp-base-port")
    return {role: number or 0 for role, number in stated.items()}


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
def ports(options: EmulateOptions) -> Iterator[tuple[Clock, dict[str, Port]]]:
    """Open the twin and a port for each device; yields its clock, and the ports by role.

    Raises:
        TwinError: See ``emulate``.
    """
    from scan3d_twin.devices.links.line_model import Faults, Line
    from scan3d_twin.devices.links.pty import PtyPort
    from scan3d_twin.devices.links.tcp import TcpPort
    from scan3d_twin.sim.robot import open_robot
    from scan3d_twin.sim.scenes.load import load_scene

    # What is emulated
    models = _models(options)
    wiring = _wiring(options, models.lidar)
    if not 0 <= options.corrupt <= 0.1:
        raise ConfigError(f"--corrupt must be within 0 and 0.1, got {options.corrupt:g}")
    p = options.corrupt
    faults = Faults(drop=p, insert=p, flip=p)
    numbers = _tcp_ports(options)

    def port(device: Device, role: str) -> PtyPort | TcpPort:
        line = Line(device, faults, options.seed + ROLES.index(role), ADAPTER_LATENCY)
        opened = PtyPort(line) if numbers is None else TcpPort(line, port=numbers[role])
        return stack.enter_context(closing(opened))

    # Open the twin, then its ports
    scene = load_scene(options.scene, options.mesh_scale, mesh_up=options.mesh_up)
    served: dict[str, Port] = {}
    with open_robot(scene, options.seed, _twin(options, models)) as robot, ExitStack() as stack:
        if not models.base.spec.is_stand:
            served["base"] = port(models.base.emulate(robot.base), "base")
        served["lidar"] = port(models.lidar.emulate(robot.lidar, wiring), "lidar")
        if models.turntable is not None and robot.turntable is not None:
            served["turntable"] = port(models.turntable.emulate(robot.turntable), "turntable")
        yield robot.clock, served


@dataclass(frozen=True, slots=True)
class _Models:
    """The devices to emulate; without a turntable the base turns the lidar."""

    base: BaseDevice
    lidar: LidarDevice
    turntable: TurntableDevice | None


def _models(options: EmulateOptions) -> _Models:
    """Return the devices that are named; a pattern means the default turntable."""
    from scan3d_twin.devices.registry import base_device, lidar_device, turntable_device
    from scan3d_twin.sim.turntable.model import DEFAULT_TURNTABLE

    is_turned = names_turntable(options) or options.pattern is not None
    turntable = turntable_device(options.turntable or DEFAULT_TURNTABLE) if is_turned else None
    return _Models(base_device(options.robot), lidar_device(options.lidar), turntable)


def _twin(options: EmulateOptions, models: _Models) -> TwinConfig:
    """Return the twin behind the emulated devices."""
    from scan3d_twin.sim.config import DEFAULT_WORLD, TwinConfig
    from scan3d_twin.sim.turntable.model import DEFAULT_TURNTABLE, TURNTABLES

    config = TwinConfig.of(DEFAULT_WORLD, options.robot, options.lidar, models.lidar.links[0])
    config = replace(config, errors=replace(config.errors, reckoning="wheels"))
    if models.turntable is None:
        return config
    # Another package's turntable has no twin of its own
    name = models.turntable.name
    name = name if name in TURNTABLES else DEFAULT_TURNTABLE
    return replace(config, pattern=options.pattern or TURNTABLE_PATTERN, turntable=name)
