"""``twin emulate``: the twin's devices on serial ports, for this program's drivers and others."""

from __future__ import annotations

import json as json_module
import os
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.core.errors import ConfigError

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock
    from scan3d_twin.devices.links.line_model import Line
    from scan3d_twin.devices.links.serve import Port

NICENESS = -10
"""Scheduling priority of the emulator, -20 (first) to 19; assumption."""


@dataclass(frozen=True, kw_only=True)
class EmulateOptions:
    """What is emulated."""

    scene: str = "three_boxes"
    """Name of a scene (`twin scenes`), or an .xml, .stl, .ply, .obj or .glb file."""
    base: Literal["create1", "create2"] = "create2"
    """Model of the base."""
    lidar_cable: Literal["usb", "serial"] = "usb"
    """Cable of the lidar; the bit rate matters over serial only."""
    lidar_baud: int = 19200
    """Bit rate of the lidar after power-up."""
    scip: Literal["1.1", "2.0"] = "2.0"
    """Protocol of the lidar after power-up."""
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
            line = f"twin real --port {base.path} --lidar-port {lidar.path}"
        print(line, flush=True)
        _raise_priority()
        serve([base, lidar], clock)


def _raise_priority() -> None:
    """Run before other programs where that is permitted: a real device is never busy elsewhere."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)


@contextmanager
def ports(options: EmulateOptions) -> Iterator[tuple[Clock, Port, Port]]:
    """Open the twin and its two ports; yields its clock, the base's port and the lidar's.

    Raises:
        TwinError: See ``emulate``.
    """
    from scan3d_twin.devices.create import codec as oi
    from scan3d_twin.devices.create.emulator import CreateEmulator
    from scan3d_twin.devices.links.line_model import Faults, Line
    from scan3d_twin.devices.links.pty import PtyPort
    from scan3d_twin.devices.links.tcp import TcpPort
    from scan3d_twin.devices.urg import codec as scip
    from scan3d_twin.devices.urg.emulated_profile import UrgProfile
    from scan3d_twin.devices.urg.emulator import UrgEmulator
    from scan3d_twin.sim.robot import open_robot

    if options.lidar_baud not in scip.BAUDS:
        known = ", ".join(map(str, scip.BAUDS))
        raise ConfigError(f"--lidar-baud must be one of {known}, got {options.lidar_baud}")
    if not 0 <= options.corrupt <= 0.1:
        raise ConfigError(f"--corrupt must be within 0 and 0.1, got {options.corrupt:g}")
    p = options.corrupt
    faults = Faults(drop=p, insert=p, flip=p)
    profile = UrgProfile(
        usb=options.lidar_cable == "usb", baud=options.lidar_baud, scip1=options.scip == "1.1"
    )
    model = {"create1": oi.CREATE1, "create2": oi.CREATE2}[options.base]

    def port(line: Line) -> PtyPort | TcpPort:
        opened = TcpPort(line) if options.tcp else PtyPort(line)
        return stack.enter_context(closing(opened))

    with open_robot(options.scene, options.seed) as robot, ExitStack() as stack:
        base = port(Line(CreateEmulator(robot.base, model), faults, options.seed))
        lidar = port(Line(UrgEmulator(robot.lidar, profile), faults, options.seed + 1))
        yield robot.clock, base, lidar
