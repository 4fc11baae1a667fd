"""``twin real``: digitise what stands in front of the real robot."""

from __future__ import annotations

import json as json_module
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass, replace
from math import degrees
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from scan3d_twin.cli.begin import begun
from scan3d_twin.cli.dotted import dotted_options, stated
from scan3d_twin.cli.options import (
    TURNTABLE_PATTERN,
    PortOptions,
    RunOptions,
    names_turntable,
    stated_options,
)
from scan3d_twin.cli.viewing import ViewOptions
from scan3d_twin.core.config import Config, Pattern, preset_options
from scan3d_twin.core.errors import ConfigError, HazardError, ScanError
from scan3d_twin.run.settings import (
    REAL_SCENE,
    Options,
    Settings,
    build_settings,
    device_options,
)

if TYPE_CHECKING:
    from pathlib import Path

    from scan3d_twin.api.resume import ResumedRun
    from scan3d_twin.core.hal import Robot
    from scan3d_twin.devices.registry import Devices
    from scan3d_twin.real.robot import CarriedTurntable
    from scan3d_twin.recording.recorder import SerialTaps

    DottedOptions = Any
else:
    DottedOptions = dotted_options(Config)

AUTO = "auto"
"""Name of the lidar that stands for the one that is plugged in."""
REHEARSED_LINES = 20
"""Lines read by a dry run: 2 s at 10 Hz."""
SMALL_COMPUTER = {"optimize_for": "memory"}
"""Default on a robot's own computer, which has little memory."""
USABLE_SHARE = 0.1
"""A lidar with fewer returns than this share of its beams is blind: a cover is on it."""


@dataclass(frozen=True, kw_only=True)
class RealOptions(ViewOptions, RunOptions, PortOptions):
    """The options of the real robot; None is not stated."""

    dry_run: bool = False
    """Read both devices and report if the robot could start; do not move."""


def real(
    *,
    options: Annotated[RealOptions, Parameter(name="*")] = RealOptions(),
    dotted: Annotated[DottedOptions | None, Parameter(name="*")] = None,
) -> None:
    """Digitise what stands in front of the real robot.

    The robot turns once to look around, drives round the target, scans it, and writes model.ply,
    report.json, top_view.svg, config.toml and views/NNN.npz. Ctrl-C stops it at once; finished
    views are saved. Later sources take precedence: defaults, preset, --config FILE, environment
    (TWIN_EPSILON, ...), command line.

    Raises:
        TwinError: The scan failed or was stopped; the views finished by then are saved.
    """
    from scan3d_twin.cli.memory import give_back_memory
    from scan3d_twin.cli.multi_target import run_each
    from scan3d_twin.cli.run import run
    from scan3d_twin.recording.recorder import SerialTaps

    give_back_memory()
    watch = options.watch()  # obeys commands from here on
    given = {} if dotted is None else stated(dotted)
    options = name_lidar(options)
    resume = None if options.resume is None else _going_on(options, options.resume, given)
    effective = resolve(options, given) if resume is None else resume.settings
    taps = SerialTaps()
    turning = Turning(effective.twin.pattern, effective.twin.turntable)
    opening = open_robot(options, _devices(options, effective, given), taps, turning)
    if options.dry_run:
        with opening as (robot, _):
            rehearse(robot, as_json=options.json)
        return
    if options.targets is not None:
        run_each(
            effective,
            REAL_SCENE,
            opening,
            options.out,
            options.targets,
            as_json=options.json,
            watch=watch,
            taps=taps,
        )
        return
    with begun(REAL_SCENE, options.out) if resume is None else nullcontext(resume.folder) as folder:
        run(
            effective,
            REAL_SCENE,
            opening,
            folder,
            as_json=options.json,
            taps=taps,
            resume=resume,
            watch=watch,
        )


def resolve(options: RealOptions, sections: Options) -> Settings:
    """Return the effective settings."""
    from scan3d_twin.core.planning import check_planner

    given = stated_options(options, sections)
    named = build_settings([given])
    stands_for = [device_options(named.twin.devices), preset_options(named.run.preset)]
    effective = build_settings([*stands_for, SMALL_COMPUTER, given, {"run": {"scene": REAL_SCENE}}])
    check_planner(effective.config.planner, truth_known=False)
    return effective


def _devices(options: RealOptions, effective: Settings, sections: Options) -> Devices:
    """Return the devices; the base is stated by the user or the earlier run, or to be found out."""
    is_stated = options.resume is not None or "robot" in stated_options(options, sections)
    return replace(effective.twin.devices, is_base_stated=is_stated)


def _going_on(options: RealOptions, folder: Path, sections: Options) -> ResumedRun:
    """Return how the run in ``folder`` goes on."""
    from scan3d_twin.api.resume import resume_real
    from scan3d_twin.cli.multi_target import refuse_resume

    refuse_resume(folder, options.targets)
    return resume_real(folder, options.out, stated_options(options, sections))


def name_lidar(options: RealOptions) -> RealOptions:
    """Return ``options`` with the name of the lidar that is plugged in, where it is to be found.

    Raises:
        LinkError: There is no such port, the base is not on its own, or no lidar is recognised.
    """
    if options.lidar != AUTO:
        return options
    from scan3d_twin.devices.links.transport import SerialTransport
    from scan3d_twin.devices.registry import DEFAULT_BASE, Devices, base_device
    from scan3d_twin.real.clock import RealClock
    from scan3d_twin.real.ports import choose_lidar_port, choose_ports
    from scan3d_twin.real.probe import find_lidar
    from scan3d_twin.real.robot import identify_base

    # A question to a lidar may be a command to a base: first see where that is
    port = choose_lidar_port(options.port, options.lidar_port)
    devices = Devices(options.robot or DEFAULT_BASE)
    if not base_device(devices.base).spec.is_stand:
        base_port, _ = choose_ports(options.port, port, devices)
        with closing(SerialTransport(base_port)) as link:
            identify_base(link, RealClock(), options.robot)
    name = find_lidar(lambda: SerialTransport(port), RealClock())
    print(f"lidar on {port}: {name}", file=sys.stderr)
    return replace(options, lidar=name, lidar_port=port)


@dataclass(frozen=True, slots=True)
class Turning:
    """What turns the lidar.

    Attributes:
        pattern: The base (``yaw-base``), or a turntable about one of its axes.
        turntable: Name of the turntable.
    """

    pattern: Pattern
    turntable: str


def choose_turning(options: PortOptions) -> Turning:
    """Return what turns the lidar by the options alone."""
    from scan3d_twin.cli.defaults import default_settings

    twin = default_settings().twin
    pattern = options.pattern or (TURNTABLE_PATTERN if names_turntable(options) else twin.pattern)
    return Turning(pattern, options.turntable or twin.turntable)


def open_robot(
    options: PortOptions,
    devices: Devices,
    taps: SerialTaps | None = None,
    turning: Turning | None = None,
) -> AbstractContextManager[tuple[Robot, None]]:
    """Return what opens the robot on the ports that are given or found; nobody knows the truth."""
    from scan3d_twin.devices.registry import base_device
    from scan3d_twin.real.ports import choose_ports, ports_but, refuse_same_port
    from scan3d_twin.real.robot import open_real

    @contextmanager
    def opened() -> Iterator[tuple[Robot, None]]:
        # The port of a turntable may look like one of a base
        port, carried = carry_turntable(options, turning or choose_turning(options))
        free = None if port is None else ports_but(port)
        is_stand = base_device(devices.base).spec.is_stand
        if is_stand and options.port is not None:
            raise ConfigError("a stand has no port: leave out --port")
        own = "-" if is_stand else options.port
        ports = choose_ports(own, options.lidar_port, devices, free)
        for role, other in zip(("base", "lidar"), ports, strict=True):
            if port is not None:
                refuse_same_port(other, port, (role, "turntable"))
        base = devices.base if devices.is_base_stated or is_stand else None
        with open_real(
            None if is_stand else ports[0],
            ports[1],
            base=base,
            lidar=devices.lidar,
            link=devices.link,
            taps=taps,
            turntable=carried,
        ) as robot:
            yield robot, None

    return opened()


def carry_turntable(
    options: PortOptions, turning: Turning
) -> tuple[str, CarriedTurntable] | tuple[None, None]:
    """Return the port of the turntable, and what carries the lidar; None where the base turns it.

    Raises:
        UnknownNameError: There is no such turntable.
        ConfigError: A turntable is named, but the base turns the lidar.
        LinkError: Its port is not found.
    """
    from scan3d_twin.core.scanning.patterns import find_mount
    from scan3d_twin.devices.links.transport import SerialTransport
    from scan3d_twin.real.ports import choose_turntable_port
    from scan3d_twin.real.robot import CarriedTurntable

    mount = find_mount(turning.pattern)
    if mount is None:
        if names_turntable(options):
            raise ConfigError(
                f"a turntable turns nothing by --pattern {turning.pattern}: leave one out"
            )
        return None, None
    port = choose_turntable_port(options.turntable_port, turning.turntable)
    place = mount.T_base_axis, mount.T_base_lidar
    return port, CarriedTurntable(turning.turntable, lambda: SerialTransport(port), *place)


def rehearse(robot: Robot, *, as_json: bool) -> None:
    """Read all devices and print their state; do not move.

    Raises:
        HazardError: The robot could not drive off.
        ScanError: The lidar has hardly any returns.
    """
    from scan3d_twin.devices.rotating import share_seen

    lines = [robot.lidar.read_line(1.0) for _ in range(REHEARSED_LINES)]
    seen = sum(map(share_seen, lines)) / len(lines)
    rate = (len(lines) - 1) / (lines[-1].stamp - lines[0].stamp)
    hazards = robot.base.hazards()
    found = {
        "base": robot.base.spec.name,
        "battery_percent": round(100 * hazards.battery),
        "hazards": list(hazards.active()),
        "lidar_hz": round(rate, 2),
        "lidar_beams": robot.lidar.spec.n_beams,
        "lidar_seen_percent": round(100 * seen),
    }
    if robot.turntable is not None:
        angle = robot.turntable.angle().angle
        found |= {"turntable": robot.turntable.spec.name, "turntable_deg": round(degrees(angle), 1)}
    if as_json:
        print(json_module.dumps(found, indent=2))
    else:
        print("\n".join(f"{name.replace('_', ' ')}: {value}" for name, value in found.items()))
    if hazards.active():
        raise HazardError(f"the robot could not drive off: {', '.join(hazards.active())}")
    if seen < USABLE_SHARE:
        raise ScanError(f"only {seen:.0%} of the lidar's beams return: remove its cover, clean it")
