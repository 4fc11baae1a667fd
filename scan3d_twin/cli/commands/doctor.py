"""``twin doctor``: check everything the real robot needs, and name a cure for what is wrong."""

from __future__ import annotations

import grp
import importlib
import json as json_module
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.options import PortOptions
from scan3d_twin.core.errors import LinkError, TwinError

if TYPE_CHECKING:
    from scan3d_twin.core.hal import Clock

LIBRARIES = ("numpy", "scipy", "serial", "mujoco", "trimesh")
WATCHED = 1.0
"""How long the base's stream is watched [s]."""
LINES = 20
"""Lines over which the lidar's rate is measured."""
LOW_BATTERY = 0.25
"""Below this the base should be charged before a run of some 20 minutes."""


@dataclass(frozen=True, kw_only=True)
class DoctorOptions(PortOptions):
    """What is checked."""

    json: bool = False
    """Print one JSON document."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        what: What was checked.
        ok: Whether it passed.
        found: What was found.
        cure: What to do about it; empty if nothing.
    """

    what: str
    ok: bool
    found: str
    cure: str = ""


def doctor(*, options: Annotated[DoctorOptions, Parameter(name="*")] = DoctorOptions()) -> None:
    """Check ports, permissions, base, lidar and libraries; nothing moves.

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
    from scan3d_twin.real.clock import RealClock
    from scan3d_twin.real.ports import choose_ports, usb_ports

    yield _libraries()
    yield from _modem_manager()
    listed = ", ".join(map(str, usb_ports())) or "none"
    yield Finding("serial ports on USB", True, listed)
    clock = RealClock()
    for what, index, look in (("base", 0, _base), ("lidar", 1, _lidar)):
        given = (options.port, options.lidar_port)[index]
        try:
            # The other one's name does not matter here, so it is made up.
            pair = (given, "-") if index == 0 else ("-", given)
            port = choose_ports(*pair)[index]
        except LinkError as error:
            yield Finding(what, False, "not found", str(error))
            continue
        yield from _port(what, port)
        yield from _answers(what, port, clock, look)


def _libraries() -> Finding:
    missing = [name for name in LIBRARIES if not _imports(name)]
    if missing:
        return Finding("libraries", False, f"{', '.join(missing)} cannot be imported", "make setup")
    return Finding("libraries", True, ", ".join(LIBRARIES))


def _imports(name: str) -> bool:
    try:
        importlib.import_module(name)
    except (ImportError, OSError):
        return False
    return True


def _modem_manager() -> Iterator[Finding]:
    """Yield a warning if the service that probes every new serial port is running."""
    for path in Path("/proc").glob("[0-9]*/comm"):
        try:
            running = path.read_text().strip() == "ModemManager"
        except OSError:
            continue
        if running:
            yield Finding(
                "ModemManager",
                False,
                "it probes each new serial port for half a minute, also the lidar's",
                "sudo systemctl disable --now ModemManager",
            )


def _port(what: str, port: str) -> Iterator[Finding]:
    """Yield whether the port may be used, and which programs use it."""
    from scan3d_twin.devices.links.transport import holders

    if "://" in port:
        return
    path = Path(port)
    if not path.exists():
        yield Finding(f"{what} port", False, f"{port} does not exist", "plug it in, check the name")
        return
    group = grp.getgrgid(path.stat().st_gid).gr_name
    if os.access(path, os.R_OK | os.W_OK):
        yield Finding(f"{what} port", True, f"{port}, group {group}, permitted")
    else:
        cure = f"sudo usermod -aG {group} $USER, then log in again"
        yield Finding(f"{what} port", False, f"no permission for {port} (group {group})", cure)
    if others := holders(port):
        yield Finding(f"{what} port is free", False, f"in use by {', '.join(others)}", "end it")


def _answers(
    what: str, port: str, clock: Clock, look: Callable[[str, Clock], Iterator[Finding]]
) -> Iterator[Finding]:
    try:
        yield from look(port, clock)
    except TwinError as error:
        yield Finding(what, False, "does not work", str(error))


def _base(port: str, clock: Clock) -> Iterator[Finding]:
    """Yield the state of the base, which stays in mode Passive."""
    from scan3d_twin.devices.create.driver import open_create
    from scan3d_twin.devices.links.transport import SerialTransport

    with (
        closing(SerialTransport(port)) as link,
        closing(open_create(link, clock)) as base,
    ):
        until, start = clock.now() + WATCHED, len(base.odometry_since(0.0))
        while clock.now() < until:
            clock.sleep(0.005)
            base.service(clock.now())
        contact, hazards = base.contact, base.hazards()
        heard = len(base.odometry_since(0.0)) - start
        expected = WATCHED / base.spec.sample_period
        offset = ", mode reported one too high" if contact.mode_offset else ""
        mode = base.mode.name.title()
        found = f"{contact.model.name} at {contact.baud} baud, mode {mode}{offset}"
        yield Finding("base", True, found)
        yield Finding(
            "base readings",
            heard > 0.9 * expected,
            f"{heard / WATCHED:.0f} per second of {expected:.0f}, {base.bad} dropped",
            "" if heard > 0.9 * expected else "check the cable; route it away from the motors",
        )
        charge = f"{hazards.battery:.0%}"
        low = hazards.battery < LOW_BATTERY
        yield Finding("base battery", not low, charge, "charge the base" if low else "")
        if base.charging:
            yield Finding("base charger", False, "plugged in", "unplug it to drive")
        names = ", ".join(hazards.active())
        cure = "put it on the floor, free its bumper" if names else ""
        yield Finding("base sensors", not names, names or "nothing pressed, no cliff", cure)


def _lidar(port: str, clock: Clock) -> Iterator[Finding]:
    """Yield the state of the lidar, and its measured scan rate."""
    from scan3d_twin.devices.links.transport import SerialTransport
    from scan3d_twin.devices.urg.driver import UrgLidar

    started = clock.now()
    with closing(UrgLidar(lambda: SerialTransport(port), clock)) as lidar:
        version, state = lidar.info.version, lidar.info.state
        yield Finding(
            "lidar",
            True,
            f"{version.get('PROD', 'unknown')}, firmware {version.get('FIRM', 'unknown')}, "
            f"{version.get('PROT', 'unknown')}, ready in {clock.now() - started:.1f} s",
        )
        if "STAT" in state:
            yield Finding("lidar state", True, state["STAT"])
        lines = [lidar.read_line(2.0) for _ in range(LINES)]
        rate = (LINES - 1) / (lines[-1].stamp - lines[0].stamp)
        wanted = 1 / lidar.spec.line_period
        good = rate > 0.95 * wanted
        cure = "" if good else "use USB, or --lidar-link 115200-full; check the cable"
        found = f"{rate:.2f} Hz of {wanted:.0f}, {lidar.stats.bad} dropped"
        yield Finding("lidar rate", good, found, cure)
        seen = sum(float((line.ranges > 0).mean()) for line in lines) / LINES
        yield Finding("lidar view", seen > 0.1, f"{seen:.0%} of the beams return")
