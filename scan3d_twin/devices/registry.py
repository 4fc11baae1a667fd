"""Devices by name: built-in ones, loaded on first use, and those of other packages.

Each folder of ``devices`` is a family, whose ``__init__`` names its devices.

Other packages add devices through the entry point groups ``scan3d_twin.lidars``,
``scan3d_twin.bases`` and ``scan3d_twin.turntables``: a name, and a ``LidarDevice``, a
``BaseDevice`` or a ``TurntableDevice`` (docs/extending.md).
Importing this module is cheap (no numpy).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pkgutil import iter_modules, resolve_name
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.plugins import PluginError, load_plugin

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from scan3d_twin.devices.device import BaseDevice, LidarDevice, LidarProbe, TurntableDevice

D = TypeVar("D", "BaseDevice", "LidarDevice", "TurntableDevice")
LIDARS, BASES = "scan3d_twin.lidars", "scan3d_twin.bases"
TURNTABLES = "scan3d_twin.turntables"
"""Entry point groups in which other packages offer devices."""
_STATED_IN = {LIDARS: "LIDARS", BASES: "BASES", TURNTABLES: "TURNTABLES"}
"""Attribute of a family's package that states its devices, by group."""
DEFAULT_LIDAR, DEFAULT_BASE, DEFAULT_LINK = "urg04lx", "create2", "usb"
"""The devices of the paper's robot."""


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
        # Names are known by letters and digits
        base, lidar = find_name(self.base, BASES), find_name(self.lidar, LIDARS)
        object.__setattr__(self, "base", base)
        object.__setattr__(self, "lidar", lidar)
        if base not in _own(BASES) and base not in base_names():
            raise _unknown("robot", base, BASES)
        object.__setattr__(self, "link", _choose_link(lidar, self.link))


def find_name(name: str, group: str) -> str:
    """Return the name of a device of a ``group`` that ``name`` spells, such as urg_04lx; else it.

    Case, underscores, hyphens and spaces do not matter.
    """
    if name in _own(group):
        return name
    known = _names(group)
    return name if name in known else {_squeeze(k): k for k in known}.get(_squeeze(name), name)


def _squeeze(name: str) -> str:
    """Return the letters and digits of ``name``, in lower case."""
    return re.sub(r"[\W_]", "", name).lower()


def lidar_names() -> tuple[str, ...]:
    """Return the names that ``lidar_device`` knows."""
    return _names(LIDARS)


def base_names() -> tuple[str, ...]:
    """Return the names that ``base_device`` knows."""
    return _names(BASES)


def turntable_names() -> tuple[str, ...]:
    """Return the names that ``turntable_device`` knows."""
    return _names(TURNTABLES)


def lidar_device(name: str) -> LidarDevice:
    """Return the lidar called ``name``.

    Raises:
        UnknownNameError: There is none.
        PluginError: The package that offers it cannot be loaded, or what it offers is no lidar of
            this name.
    """
    from scan3d_twin.devices.device import LidarDevice

    name = find_name(name, LIDARS)
    device = _load("lidar", name, LIDARS, LidarDevice)
    if not device.links:
        raise PluginError("lidar", name, _place("lidar", name, LIDARS), "it has no links")
    return device


def lidar_probes() -> tuple[LidarProbe, ...]:
    """Return how lidars are recognised, once for each family: first those that only listen."""
    stated = (lidar_device(name).probe for name in lidar_names())
    probes = dict.fromkeys(probe for probe in stated if probe is not None)
    return tuple(sorted(probes, key=lambda probe: bool(probe.request)))


def base_device(name: str) -> BaseDevice:
    """Return the base called ``name``; raises the errors of ``lidar_device``."""
    from scan3d_twin.devices.device import BaseDevice

    name = find_name(name, BASES)
    device = _load("robot", name, BASES, BaseDevice)
    _check_spec("robot", name, device.spec.name, BASES)
    return device


def turntable_device(name: str) -> TurntableDevice:
    """Return the turntable called ``name``; raises the errors of ``lidar_device``."""
    from scan3d_twin.devices.device import TurntableDevice

    name = find_name(name, TURNTABLES)
    device = _load("turntable", name, TURNTABLES, TurntableDevice)
    _check_spec("turntable", name, device.spec.name, TURNTABLES)
    return device


def _check_spec(kind: str, name: str, spec_name: str, group: str) -> None:
    """Refuse a device whose spec has another name."""
    if spec_name != name:
        raise PluginError(
            kind, name, _place(kind, name, group), f"its spec's name is {spec_name!r}"
        )


@cache
def _own(group: str) -> dict[str, str]:
    """Return the place of each built-in device of a ``group``: module and attribute.

    The package of each family states its devices in ``LIDARS``, ``BASES`` and ``TURNTABLES``: by
    name, what they are called in its module ``device``.
    """
    own = {}
    for family in _families():
        stated: dict[str, str] = getattr(family, _STATED_IN[group], {})
        own.update({k: f"{family.__name__}.device:{name}" for k, name in stated.items()})
    return own


def _refused() -> dict[str, str]:
    """Return why devices are not offered, by a pattern of their names.

    A family states in ``REFUSED`` what its users may look for in vain; a pattern has neither
    capital letters nor separators.
    """
    stated: list[dict[str, str]] = [getattr(family, "REFUSED", {}) for family in _families()]
    return {pattern: reason for each in stated for pattern, reason in each.items()}


def _families() -> list[ModuleType]:
    """Return the package of each family of devices."""
    from scan3d_twin import devices

    found = iter_modules(devices.__path__)
    return [import_module(f"{devices.__name__}.{each.name}") for each in found if each.ispkg]


def _load(kind: str, name: str, group: str, cls: type[D]) -> D:
    """Return the device called ``name``, a ``cls``; that of another package is checked."""
    own = _own(group)
    if name in own:
        device: D = resolve_name(own[name])
        return device
    place = _place(kind, name, group)
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


def _names(group: str) -> tuple[str, ...]:
    return tuple(sorted({*_own(group), *_others(group)}))


def _place(kind: str, name: str, group: str) -> str:
    """Return where another package holds its device ``name``."""
    others = _others(group)
    if name not in others:
        raise _unknown(kind, name, group)
    return others[name].value


def _unknown(kind: str, name: str, group: str) -> ConfigError:
    """Return the error for a ``name`` that no device has, with the reason if it is refused."""
    for pattern, reason in _refused().items():
        if re.fullmatch(pattern, _squeeze(name)):
            return ConfigError(f"no {kind} {name!r}: {reason}")
    return UnknownNameError(kind, name, _names(group))


def _others(group: str) -> dict[str, EntryPoint]:
    """Return other packages' entry points by name, except those named like a built-in device."""
    from importlib.metadata import entry_points

    own = _own(group)
    return {point.name: point for point in entry_points(group=group) if point.name not in own}
