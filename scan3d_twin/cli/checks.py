"""What ``twin doctor`` checks: libraries, services, ports, and the devices on them."""

from __future__ import annotations

import grp
import importlib
import math
import os
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from scan3d_twin.core.errors import TwinError
from scan3d_twin.devices.device import Finding

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

Look = Callable[[str, "Clock"], Iterator[Finding]]
"""Yields what there is to say about the device on a port."""


def check_libraries() -> Finding:
    """Return whether the libraries can be imported."""
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


def check_modem_manager() -> Iterator[Finding]:
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


def check_port(what: str, port: str) -> Iterator[Finding]:
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


def check_answers(what: str, port: str, clock: Clock, look: Look) -> Iterator[Finding]:
    """Yield what ``look`` finds on a port; a device that does not work is a finding too."""
    try:
        yield from look(port, clock)
    except TwinError as error:
        yield Finding(what, False, "does not work", str(error))


def check_base(
    device: BaseDevice, open_base: BaseOpener, port: str, clock: Clock
) -> Iterator[Finding]:
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


def check_lidar(device: LidarDevice, port: str, clock: Clock) -> Iterator[Finding]:
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


def check_latency(port: str, root: Path = Path("/")) -> Iterator[Finding]:
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


def check_turntable(device: TurntableDevice, port: str, clock: Clock) -> Iterator[Finding]:
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
