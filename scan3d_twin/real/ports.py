"""Finding the robot's serial ports by what is plugged in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import LinkError
from scan3d_twin.devices.registry import Devices, base_device, lidar_device


@dataclass(frozen=True, slots=True)
class Port:
    """A serial port on USB.

    Attributes:
        path: The device, by a name that stays the same: /dev/serial/by-id where there is one.
        usb_id: Vendor and product id, such as ``15d1:0000``.
        product: What the device calls itself.
    """

    path: str
    usb_id: str
    product: str

    def is_one_of(self, usb_ids: Mapping[str, str]) -> bool:
        """Return whether ``usb_ids`` name the port by its vendor, or by vendor and product."""
        return self.usb_id in usb_ids or self.usb_id.partition(":")[0] in usb_ids

    def __str__(self) -> str:
        return f"{self.path} ({self.usb_id} {self.product})"


def usb_ports(root: Path = Path("/")) -> list[Port]:
    """Return the serial ports on USB, by name; ``root`` is where /dev and /sys lie."""
    names = {link.resolve(): link for link in (root / "dev/serial/by-id").glob("*")}
    ports = []
    for tty in sorted((root / "sys/class/tty").glob("tty[AU]*")):
        device = root / "dev" / tty.name
        usb = _usb_device(tty / "device")
        if usb is not None:
            path = names.get(device.resolve(), device)
            usb_id = f"{_word(usb, 'idVendor')}:{_word(usb, 'idProduct')}"
            ports.append(Port(str(path), usb_id, _word(usb, "product")))
    return ports


def choose_ports(
    base: str | None,
    lidar: str | None,
    devices: Devices | None = None,
    ports: list[Port] | None = None,
) -> tuple[str, str]:
    """Return the ports of the base and the lidar; those not given are found by their USB ids.

    Args:
        base: Port of the base; None is to be found.
        lidar: Port of the lidar; None is to be found.
        devices: What is to be found; None is the robot of the paper.
        ports: Where to look; None are the serial ports on USB.

    Raises:
        LinkError: There is none, or more than one that may be it.
    """
    if base and lidar:
        return base, lidar
    devices = Devices() if devices is None else devices
    free = usb_ports() if ports is None else ports
    free = [port for port in free if port.path not in (base, lidar)]
    return (
        base or _only(free, base_device(devices.base).usb_ids, "base", "--port"),
        lidar or _only(free, lidar_device(devices.lidar).usb_ids, "lidar", "--lidar-port"),
    )


def _only(ports: list[Port], usb_ids: Mapping[str, str], what: str, option: str) -> str:
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


def _word(usb: Path, name: str) -> str:
    try:
        return (usb / name).read_text().strip()
    except OSError:
        return ""
