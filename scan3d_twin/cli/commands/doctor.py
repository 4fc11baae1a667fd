"""``twin doctor``: check everything the real robot needs, and name a cure for what is wrong."""

from __future__ import annotations

import grp
import importlib
import json as json_module
import math
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.options import PortOptions
from scan3d_twin.core.errors import LinkError, TwinError
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
    from scan3d_twin.devices.device import (
        BaseDevice,
        BaseDriver,
        BaseOpener,
        LidarDevice,
        LidarDriver,
        TurntableDevice,
        TurntableDriver,
    )

LIBRARIES = ("numpy", "scipy", "serial", "mujoco", "trimesh")
WATCHED = 1.0
"""How long the base's stream is watched [s]."""
LINES = 20
"""Lines over which the lidar's rate is measured."""
MAX_DAMAGE = 1 / 20000
"""Damaged blocks for each byte from the lidar above which the cable is called bad, whether a block
is a line of 2137 bytes or a node of 5: nearly each damaged byte spoils one; assumption."""
SEEN_SHARE = 0.6
"""Share of the angles of a turntable below which its adapter is called slow; assumption."""
MAX_LATENCY = 1
"""Time for which an adapter may hold bytes back [ms]."""
LOW_BATTERY = 0.25
"""Below this the base should be charged before a run of some 20 minutes."""


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

Look = Callable[[str, "Clock"], Iterator[Finding]]
"""Yields what there is to say about the device on a port."""


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

    yield _libraries()
    yield from _modem_manager()
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
    looks: tuple[Look, ...] = (partial(_base, base, open_base), partial(_lidar, lidar))
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
        yield from _port(what, port)
        if what == "lidar" and not (is_base_known or lidar.sends_text):
            yield NOT_ASKED
            continue
        for finding in _answers(what, port, clock, look):
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
    yield from _port("turntable", port)
    yield from _latency(port)
    if not is_base_known:
        yield TURNTABLE_NOT_ASKED
        return
    yield from _answers("turntable", port, clock, partial(_turntable, turntable_device(name)))


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


def _answers(what: str, port: str, clock: Clock, look: Look) -> Iterator[Finding]:
    try:
        yield from look(port, clock)
    except TwinError as error:
        yield Finding(what, False, "does not work", str(error))


def _base(device: BaseDevice, open_base: BaseOpener, port: str, clock: Clock) -> Iterator[Finding]:
    """Yield what the base says; it stays at rest."""
    from scan3d_twin.devices.links.transport import SerialTransport

    with (
        closing(SerialTransport(port)) as link,
        closing(open_base(link, clock, None)) as base,
    ):
        # Listen for a while.
        until, start = clock.now() + WATCHED, len(base.odometry_since(0.0))
        while clock.now() < until:
            clock.sleep(0.005)
            base.service(clock.now())
        heard = len(base.odometry_since(0.0)) - start

        # What it is, and whether it speaks as often as it should.
        yield Finding("base", True, _described(device, base))
        expected = WATCHED / base.spec.sample_period
        yield Finding(
            "base readings",
            heard > 0.9 * expected,
            f"{heard / WATCHED:.0f} per second of {expected:.0f}, {base.bad} dropped",
            "" if heard > 0.9 * expected else "check the cable; route it away from the motors",
        )

        # What it says about itself.
        hazards = base.hazards()
        low = hazards.battery < LOW_BATTERY
        charge = f"{hazards.battery:.0%}"
        yield Finding("base battery", not low, charge, "charge the base" if low else "")
        if device.inspect is not None:
            yield from device.inspect(base)
        names = ", ".join(hazards.active())
        cure = "put it on the floor, free its bumper" if names else ""
        yield Finding("base sensors", not names, names or "nothing pressed, no cliff", cure)


def _lidar(device: LidarDevice, port: str, clock: Clock) -> Iterator[Finding]:
    """Yield what the lidar says, and how fast it really scans."""
    from scan3d_twin.devices.links.transport import SerialTransport, Tapped
    from scan3d_twin.devices.rotating import share_seen

    started, received = clock.now(), 0

    def count(time: float, way: str, data: bytes) -> None:
        nonlocal received
        received += len(data) * (way == "<")

    def open_port() -> Tapped:
        return Tapped(SerialTransport(port), clock, count)

    with closing(device.open_driver(open_port, clock, None)) as lidar:
        ready = clock.now() - started
        yield Finding("lidar", True, f"{_described(device, lidar)}, ready in {ready:.1f} s")

        # How often it scans, and how much of what it sends arrives damaged
        bad, received = lidar.bad, 0
        lines = [lidar.read_line(2.0) for _ in range(LINES)]
        bad = lidar.bad - bad
        rate = (LINES - 1) / (lines[-1].stamp - lines[0].stamp)
        wanted = 1 / lidar.spec.line_period
        good = rate > 0.95 * wanted and bad <= MAX_DAMAGE * received
        others = " or ".join(f"--lidar-link {link}" for link in device.links[1:])
        cure = "" if good else f"check the cable; try USB{others and ' or '}{others}"
        found = f"{rate:.2f} Hz of {wanted:.0f}, {bad} times damage in {received} bytes"
        yield Finding("lidar rate", good, found, cure)

        # How much it sees
        seen = sum(share_seen(line) for line in lines) / LINES
        yield Finding("lidar view", seen > 0.1, f"{seen:.0%} of the beams see something")


def _latency(port: str, root: Path = Path("/")) -> Iterator[Finding]:
    """Yield how long an FTDI adapter holds bytes back, where the system says it."""
    name = Path(port).resolve().name
    file = root / "sys/bus/usb-serial/devices" / name / "latency_timer"
    try:
        milliseconds = int(file.read_text())
    except (OSError, ValueError):
        return
    is_quick = milliseconds <= MAX_LATENCY
    cure = "" if is_quick else f"echo {MAX_LATENCY} | sudo tee {file}"
    yield Finding("turntable adapter", is_quick, f"holds bytes for {milliseconds} ms", cure)


def _turntable(device: TurntableDevice, port: str, clock: Clock) -> Iterator[Finding]:
    """Yield what the turntable says; it does not move."""
    from scan3d_twin.devices.links.transport import SerialTransport

    with closing(device.open_driver(lambda: SerialTransport(port), clock)) as table:
        # Read its angle for a while
        until, start = clock.now() + WATCHED, table.angle().stamp
        while clock.now() < until:
            clock.sleep(0.005)
            table.service(clock.now())
        rate = (len(table.angles_since(start)) - 1) / WATCHED
        angle = math.degrees(table.angle().angle)

        # What it is, and whether it speaks as often as it should
        yield Finding("turntable", True, f"{_described(device, table)}, at {angle:.1f} deg")
        wanted = 1 / table.spec.sample_period
        good = rate > SEEN_SHARE * wanted
        cure = "" if good else "check the cable; an adapter may hold bytes back: docs/hardware.md"
        found = f"{rate:.0f} angles per second of {wanted:.0f}, {table.bad} missing"
        yield Finding("turntable readings", good, found, cure)
        if device.inspect is not None:
            yield from device.inspect(table)


def _described(
    device: BaseDevice | LidarDevice | TurntableDevice,
    driver: BaseDriver | LidarDriver | TurntableDriver,
) -> str:
    return device.name if device.describe is None else device.describe(driver)
