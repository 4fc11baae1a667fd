"""Devices by name: built-in ones, loaded on first use, and those of other packages.

Other packages add devices through the entry point groups ``scan3d_twin.lidars`` and
``scan3d_twin.bases``: a name, and a ``LidarDevice`` or ``BaseDevice`` (docs/extending.md).
Importing this module is cheap (no numpy).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import TYPE_CHECKING, TypeVar

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.plugins import PluginError, load_plugin

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from scan3d_twin.devices.device import BaseDevice, LidarDevice

D = TypeVar("D", "BaseDevice", "LidarDevice")
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
        link: How the lidar is connected: one of its ``links``; where it is given empty, the first.
        is_base_stated: Whether the user has stated the base; otherwise its driver may find another
            one of the same family.
    """

    base: str = DEFAULT_BASE
    lidar: str = DEFAULT_LIDAR
    link: str = ""
    is_base_stated: bool = field(default=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.base not in _OWN_BASES and self.base not in base_names():
            raise UnknownNameError("robot", self.base, base_names())
        object.__setattr__(self, "link", _choose_link(self.lidar, self.link))


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
        PluginError: The package that offers it cannot be loaded, or what it offers is no lidar of
            this name.
    """
    from scan3d_twin.devices.device import LidarDevice

    device = _load("lidar", name, _OWN_LIDARS, LIDARS, LidarDevice)
    if not device.links:
        raise PluginError(
            "lidar", name, _place("lidar", name, _OWN_LIDARS, LIDARS), "it has no links"
        )
    return device


def base_device(name: str) -> BaseDevice:
    """Return the base called ``name``; raises the errors of ``lidar_device``."""
    from scan3d_twin.devices.device import BaseDevice

    device = _load("robot", name, _OWN_BASES, BASES, BaseDevice)
    if device.spec.name != name:
        place = _place("robot", name, _OWN_BASES, BASES)
        raise PluginError("robot", name, place, f"its spec's name is {device.spec.name!r}")
    return device


def _load(kind: str, name: str, own: dict[str, str], group: str, cls: type[D]) -> D:
    """Return the device called ``name``, a ``cls``; that of another package is checked."""
    if name in own:
        device: D = resolve_name(f"{__package__}.{own[name]}")
        return device
    place = _place(kind, name, own, group)
    device = load_plugin(kind, name, place)
    if not isinstance(device, cls):
        raise PluginError(kind, name, place, f"it is no {cls.__name__} but {device!r}")
    if device.name != name:
        raise PluginError(kind, name, place, f"its own name is {device.name!r}")
    return device


def _choose_link(lidar: str, link: str) -> str:
    """Return ``link``, or the first one of the lidar where it is empty."""
    # The default is known without loading the lidar: help pages show it, and load no NumPy.
    if lidar == DEFAULT_LIDAR and link in ("", DEFAULT_LINK):
        return DEFAULT_LINK
    links = lidar_device(lidar).links
    if link and link not in links:
        raise UnknownNameError("lidar link", link, links)
    return link or links[0]


def _names(own: dict[str, str], group: str) -> tuple[str, ...]:
    return tuple(sorted({*own, *_others(own, group)}))


def _place(kind: str, name: str, own: dict[str, str], group: str) -> str:
    """Return where another package holds its device ``name``."""
    others = _others(own, group)
    if name not in others:
        raise UnknownNameError(kind, name, _names(own, group))
    return others[name].value


def _others(own: dict[str, str], group: str) -> dict[str, EntryPoint]:
    """Return other packages' entry points by name, except those named like a built-in device."""
    from importlib.metadata import entry_points

    return {point.name: point for point in entry_points(group=group) if point.name not in own}
