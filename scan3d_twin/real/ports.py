"""Finding the robot's serial ports by their USB ids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.registry import (
    Devices,
    base_device,
    base_names,
    lidar_device,
    lidar_names,
    turntable_device,
)


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port on USB.

    Attributes:
        path: Path of the port, under /dev/serial/by-id if possible, where names are persistent.
        usb_id: Vendor and product id, such as ``15d1:0000``.
        product: Product name reported by the device.
    """

    path: str
    usb_id: str
    product: str

    def is_one_of(self, usb_ids: Mapping[str, str]) -> bool:
        """Return whether ``usb_ids`` contain the port's vendor, or its vendor and product."""
        return self.usb_id in usb_ids or self.usb_id.partition(":")[0] in usb_ids

    def __str__(self) -> str:
        return f"{self.path} ({self.usb_id} {self.product})"


def usb_ports(root: Path = Path("/")) -> list[Port]:
    """Return the serial ports on USB, sorted by name; ``root`` contains /dev and /sys."""
    names = {link.resolve(): link for link in (root / "dev/serial/by-id").glob("*")}
    ports = []
    for tty in sorted((root / "sys/class/tty").glob("tty[AU]*")):
        device = root / "dev" / tty.name
        usb = _usb_device(tty / "device")
        if usb is not None:
            path = names.get(device.resolve(), device)
            usb_id = f"{_read_attribute(usb, 'idVendor')}:{_read_attribute(usb, 'idProduct')}"
            ports.append(Port(str(path), usb_id, _read_attribute(usb, "product")))
    return ports


def choose_ports(
    base: str | None,
    lidar: str | None,
    devices: Devices | None = None,
    ports: list[Port] | None = None,
) -> tuple[str, str]:
    """Return the ports of base and lidar; those not given are found by their USB ids.

    Args:
        base: Port of the base; None to find it.
        lidar: Port of the lidar; None to find it.
        devices: Devices to look for; None is the robot of the paper.
        ports: Ports to search; None is all serial ports on USB.

    Raises:
        LinkError: No port matches, or more than one does.
    """
    if base and lidar:
        return base, lidar
    devices = Devices() if devices is None else devices
    free = usb_ports() if ports is None else ports
    free = [port for port in free if not any(_is_same(port.path, name) for name in (base, lidar))]
    return (
        base or _choose_only(free, base_device(devices.base).usb_ids, "base", "--port"),
        lidar or _choose_only(free, lidar_device(devices.lidar).usb_ids, "lidar", "--lidar-port"),
    )


def choose_turntable_port(turntable: str | None, name: str, ports: list[Port] | None = None) -> str:
    """Return the port of the turntable called ``name``; where it is not given, found by USB ids.

    Args:
        turntable: Its port; None to find it.
        name: Its name.
        ports: Ports to search; None is all serial ports on USB.

    Raises:
        LinkError: No port matches, or more than one does.
    """
    if turntable is not None:
        return turntable
    free = usb_ports() if ports is None else ports
    return _choose_only(free, turntable_device(name).usb_ids, "turntable", "--turntable-port")


def ports_but(taken: str, ports: list[Port] | None = None) -> list[Port]:
    """Return the serial ports on USB, or ``ports``, other than one that is ``taken``."""
    found = usb_ports() if ports is None else ports
    return [port for port in found if not _is_same(port.path, taken)]


def refuse_same_port(base: str, lidar: str, roles: tuple[str, str] = ("base", "lidar")) -> None:
    """Refuse one port for two devices, also under two names.

    Args:
        base: Port of the first.
        lidar: Port of the second.
        roles: What they are.

    Raises:
        LinkError: Both are on the same port.
    """
    # That there is no such port is said when it is opened
    if _is_same(base, lidar) and ("://" in base or Path(base).exists()):
        raise _same_port_error(base, lidar, roles)


def _same_port_error(
    base: str, lidar: str, roles: tuple[str, str] = ("base", "lidar")
) -> LinkError:
    names = base if base == lidar else f"{base}, which is {lidar},"
    both = " and ".join(roles)
    return LinkError(f"{names} cannot be the port of both {both}: name another for one")


def _is_same(a: str, b: str | None) -> bool:
    """Return whether two names are those of one port, for example a link and what it leads to."""
    if b is None or "://" in a or "://" in b:
        return a == b
    return Path(a).resolve() == Path(b).resolve()


def choose_lidar_port(base: str | None, lidar: str | None, ports: list[Port] | None = None) -> str:
    """Return the port of a lidar of any kind; where it is not given, found by USB ids.

    Args:
        base: Port of the base; None if it is not known: then no port that may be a base's is
            chosen, as a question to a lidar may be a command to a base.
        lidar: Port of the lidar; None to find it.
        ports: Ports to search; None is all serial ports on USB.

    Raises:
        LinkError: It is the base's, no port matches, or more than one does.
    """
    if lidar is not None:
        if base is not None and _is_same(lidar, base):
            raise _same_port_error(base, lidar)
        return lidar
    ids = {k: v for name in lidar_names() for k, v in lidar_device(name).usb_ids.items()}
    free = usb_ports() if ports is None else ports
    free = [port for port in free if not _is_same(port.path, base)]
    if base is None:
        bases = {k: v for name in base_names() for k, v in base_device(name).usb_ids.items()}
        free = [port for port in free if not port.is_one_of(bases)]
    return _choose_only(free, ids, "lidar", "--lidar-port")


def _choose_only(ports: list[Port], usb_ids: Mapping[str, str], what: str, option: str) -> str:
    found = [port for port in ports if port.is_one_of(usb_ids)]
    if not found:
        makers = ", ".join(usb_ids.values())
        raise LinkError(
            f"no {what} found on USB ({makers}): plug it in, or name its port with {option}"
        )
    if len(found) > 1:
        each = ", ".join(map(str, found))
        raise LinkError(f"{len(found)} ports may be the {what}: {each}; name one with {option}")
    return found[0].path


def _usb_device(device: Path) -> Path | None:
    """Return the USB device that a port belongs to."""
    if not device.exists():
        return None
    real = device.resolve()
    return next((each for each in [real, *real.parents] if (each / "idVendor").is_file()), None)


def _read_attribute(usb: Path, name: str) -> str:
    try:
        return (usb / name).read_text().strip()
    except OSError:
        return ""
