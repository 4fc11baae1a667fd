"""``twin doctor``: check everything the real robot needs, and name a cure for what is wrong."""

from __future__ import annotations

import json as json_module
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.checks import (
    Look,
    check_answers,
    check_base,
    check_latency,
    check_libraries,
    check_lidar,
    check_modem_manager,
    check_port,
    check_turntable,
)
from scan3d_twin.cli.options import PortOptions
from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.device import Finding
from scan3d_twin.devices.registry import (
    DEFAULT_BASE,
    DEFAULT_LIDAR,
    Devices,
    base_device,
    lidar_device,
    turntable_device,
)

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock

NOT_ASKED = Finding(
    "lidar",
    False,
    "not asked",
    "a base is first to be found on the other port: what this lidar is sent may make a base drive",
)
"""Said of a lidar whose requests may be commands to a base, as long as the base is not known."""

TURNTABLE_NOT_ASKED = Finding(
    "turntable",
    False,
    "not asked",
    "a base is first to be found on the other port: what it is sent may make a base drive",
)
"""The same of a turntable."""


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(PortOptions):
    """What is checked."""

    json: bool = False
    """Print one JSON document."""


def doctor(*, options: Annotated[DoctorOptions, Parameter(name="*")] = DoctorOptions()) -> None:
    """Check ports, permissions, base, lidar, turntable and libraries; nothing moves.

    Raises:
        LinkError: A check failed; all findings have been printed.
    """
    findings = []
    for finding in examine(options):
        findings.append(finding)
        if not options.json:
            print(words(finding), flush=True)
    if options.json:
        print(json_module.dumps([asdict(finding) for finding in findings], indent=2))
    bad = [finding.what for finding in findings if not finding.ok]
    if bad:
        raise LinkError(f"{len(bad)} of {len(findings)} checks failed: {', '.join(bad)}")


def words(finding: Finding) -> str:
    """Return ``finding`` as a line or two for people."""
    mark = "ok  " if finding.ok else "BAD "
    cure = f"\n     -> {finding.cure}" if finding.cure else ""
    return f"{mark} {finding.what}: {finding.found}{cure}"


def examine(options: PortOptions) -> Iterator[Finding]:
    """Yield the result of each check, the simplest first."""
    from scan3d_twin.cli.commands.real import choose_turning
    from scan3d_twin.real.clock import RealClock
    from scan3d_twin.real.ports import choose_ports, ports_but, refuse_same_port, usb_ports

    yield check_libraries()
    yield from check_modem_manager()
    listed = ", ".join(map(str, usb_ports())) or "none"
    yield Finding("serial ports on USB", True, listed)
    if options.port and options.lidar_port:
        try:
            refuse_same_port(options.port, options.lidar_port)
        except LinkError as error:
            yield Finding("ports", False, "one for both", str(error))
            return
    base = base_device(options.robot or DEFAULT_BASE)
    lidar = lidar_device(options.lidar or DEFAULT_LIDAR)
    devices, clock = Devices(base.name, lidar.name, lidar.links[0]), RealClock()
    open_base = base.opener(is_stated=options.robot is not None)
    looks: tuple[Look, ...] = (partial(check_base, base, open_base), partial(check_lidar, lidar))
    base_port, is_base_known = "-", base.spec.is_stand
    turning, taken = choose_turning(options), options.turntable_port
    free = None if taken is None else ports_but(taken)
    for what, index, look in (("base", 0, looks[0]), ("lidar", 1, looks[1])):
        given = (options.port, options.lidar_port)[index]
        if what == "base" and base.spec.is_stand:
            yield Finding("base", True, base.summary)
            continue
        try:
            # The lidar's name does not matter to the base, so it is made up.
            names = (given, options.lidar_port or "-") if index == 0 else (base_port, given)
            port = choose_ports(names[0], names[1], devices, free)[index]
        except LinkError as error:
            yield Finding(what, False, "not found", str(error))
            continue
        yield from check_port(what, port)
        if what == "lidar" and not (is_base_known or lidar.sends_text):
            yield NOT_ASKED
            continue
        for finding in check_answers(what, port, clock, look):
            is_base_known |= finding.what == what == "base" and finding.ok
            yield finding
        base_port = port
    if turning.pattern != "yaw-base":
        yield from _examine_turntable(options, turning.turntable, clock, is_base_known)


def _examine_turntable(
    options: PortOptions, name: str, clock: Clock, is_base_known: bool
) -> Iterator[Finding]:
    """Yield the checks of the turntable called ``name``."""
    from scan3d_twin.real.ports import choose_turntable_port

    try:
        port = choose_turntable_port(options.turntable_port, name)
    except LinkError as error:
        yield Finding("turntable", False, "not found", str(error))
        return
    yield from check_port("turntable", port)
    yield from check_latency(port)
    if not is_base_known:
        yield TURNTABLE_NOT_ASKED
        return
    yield from check_answers(
        "turntable", port, clock, partial(check_turntable, turntable_device(name))
    )
