"""Finding the robot's serial ports by what is plugged in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scan3d_twin.core.errors import LinkError

LIDARS = {"15d1": "Hokuyo"}
"""Makers of lidars by USB vendor id."""
ADAPTERS = {"0403": "FTDI", "067b": "Prolific", "10c4": "Silicon Labs", "1a86": "WCH"}
"""Makers of USB serial adapters by USB vendor id; the Create 2's own cable holds an FTDI."""


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

    @property
    def vendor(self) -> str:
        """The USB vendor id."""
        return self.usb_id.partition(":")[0]

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
    base: str | None, lidar: str | None, ports: list[Port] | None = None
) -> tuple[str, str]:
    """Return the ports of the base and the lidar; those not given are found by their USB ids.

    Raises:
        LinkError: There is none, or more than one that may be it.
    """
    if base and lidar:
        return base, lidar
    free = usb_ports() if ports is None else ports
    free = [port for port in free if port.path not in (base, lidar)]
    return (
        base or _only(free, ADAPTERS, "base", "--port"),
        lidar or _only(free, LIDARS, "lidar", "--lidar-port"),
    )


def _only(ports: list[Port], vendors: dict[str, str], what: str, option: str) -> str:
    found = [port for port in ports if port.vendor in vendors]
    if not found:
        makers = ", ".join(vendors.values())
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
