"""Devices by name: built-in ones, loaded on first use, and those of other packages.

Other packages add devices through the entry point groups ``scan3d_twin.lidars`` and
``scan3d_twin.bases``: a name, and a ``LidarDevice`` or ``BaseDevice`` (docs/extending.md).
Importing this module is cheap (no numpy).
"""

from __future__ import annotations

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from scan3d_twin.core.errors import ConfigError, UnknownNameError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from scan3d_twin.devices.device import BaseDevice, LidarDevice

LIDARS, BASES = "scan3d_twin.lidars", "scan3d_twin.bases"
"""Entry point groups in which other packages offer devices."""
DEFAULT_LIDAR, DEFAULT_BASE, DEFAULT_LINK = "urg04lx", "create2", "usb"
"""The devices of the paper's robot."""

_OWN_LIDARS = {"urg04lx": "urg.device:URG04LX"}
_OWN_BASES = {"create1": "create.device:CREATE1", "create2": "create.device:CREATE2"}
"""Built-in devices by name: module in ``devices``, and attribute in it."""


@dataclass(frozen=True, slots=True)
class Devices:
    """The devices of a robot, by name.

    Raises:
        UnknownNameError: There is no such device or link.

    Attributes:
        base: Name of the base.
        lidar: Name of the lidar.
        link: How the lidar is connected: one of its ``links``.
    """

    base: str = DEFAULT_BASE
    lidar: str = DEFAULT_LIDAR
    link: str = DEFAULT_LINK

    def __post_init__(self) -> None:
        if self.base not in _OWN_BASES and self.base not in base_names():
            raise UnknownNameError("robot", self.base, base_names())
        if (self.lidar, self.link) == (DEFAULT_LIDAR, DEFAULT_LINK):
            return  # known to be right without loading it: help pages show it, and load no NumPy
        links = lidar_device(self.lidar).links
        if self.link not in links:
            raise UnknownNameError("lidar link", self.link, links)


def lidar_names() -> tuple[str, ...]:
    """Return the names that ``lidar_device`` knows."""
    return _names(_OWN_LIDARS, LIDARS)


def base_names() -> tuple[str, ...]:
    """Return the names that ``base_device`` knows."""
    return _names(_OWN_BASES, BASES)


def lidar_device(name: str) -> LidarDevice:
    """Return the lidar called ``name``.

    Raises:
        UnknownNameError: There is none.
        ConfigError: The package that offers it cannot be loaded.
    """
    device: LidarDevice = _load("lidar", name, _OWN_LIDARS, LIDARS)
    return device


def base_device(name: str) -> BaseDevice:
    """Return the base called ``name``; raises the errors of ``lidar_device``."""
    device: BaseDevice = _load("robot", name, _OWN_BASES, BASES)
    return device


def _names(own: dict[str, str], group: str) -> tuple[str, ...]:
    return tuple(sorted({*own, *_others(own, group)}))


def _load(kind: str, name: str, own: dict[str, str], group: str) -> Any:
    if name in own:
        return resolve_name(f"{__package__}.{own[name]}")
    others = _others(own, group)
    if name not in others:
        raise UnknownNameError(kind, name, _names(own, group))
    try:
        return others[name].load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"{kind} {name} ({others[name].value}) cannot be loaded: {error}"
        ) from None


def _others(own: dict[str, str], group: str) -> dict[str, EntryPoint]:
    """Return other packages' entry points by name, except those named like a built-in device."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group) if point.name not in own}
