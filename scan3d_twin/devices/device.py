"""What the rest of the house knows about a device: one description for each lidar and base.

A family of devices is one folder with the same files in each: ``model.py`` (the numbers of the data
sheet, with their sources), ``codec.py`` (bytes to values and back), ``driver.py``, ``emulator.py``,
and ``device.py``, which describes the devices of the family by the classes below. ``registry``
finds the descriptions by name, those of other packages too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from scan3d_twin.core.hal import BaseSpec, Clock, DriveBase, Lidar
from scan3d_twin.core.types import LidarSpec

if TYPE_CHECKING:
    from scan3d_twin.devices.links.guard import Guard
    from scan3d_twin.devices.links.line_model import Device
    from scan3d_twin.devices.links.transport import Transport

ConfigTables = Mapping[str, Mapping[str, Any]]
"""Options by section and name, as in a configuration file."""


class LidarDriver(Lidar, Protocol):
    """A ``Lidar`` over a line."""

    @property
    def bad(self) -> int:
        """How many lines and other blocks arrived damaged."""
        ...

    def service(self, now: float) -> None:
        """Take in what has arrived by ``now`` [s], without waiting."""
        ...

    def close(self) -> None:
        """Stop the lidar and close its port."""
        ...


class BaseDriver(DriveBase, Protocol):
    """A ``DriveBase`` over a line."""

    @property
    def bad(self) -> int:
        """How many readings arrived damaged."""
        ...

    def service(self, now: float) -> None:
        """Take in what has arrived by ``now`` [s], without waiting.

        Raises:
            HazardError: The base reports a hazard or is silent; it has been stopped.
        """
        ...

    def close(self) -> None:
        """Stop the wheels and leave the base at rest; the line stays open."""
        ...


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that ``twin doctor`` looked at.

    Attributes:
        what: Which.
        ok: Whether it is as it should be.
        found: What was found.
        cure: What to do about it; empty if nothing.
    """

    what: str
    ok: bool
    found: str
    cure: str = ""


@dataclass(frozen=True, slots=True)
class Wiring:
    """How an emulated lidar is connected and powered up.

    Attributes:
        usb: Whether it is on USB, where a bit rate means nothing.
        baud: Bit rate when powered up [bit/s]; None is the device's own.
        protocol: Protocol when powered up; None is the device's own.
    """

    usb: bool = True
    baud: int | None = None
    protocol: str | None = None


@dataclass(frozen=True, slots=True)
class ErrorCodes:
    """The codes that a lidar sends where it has no distance, by their causes."""

    no_return: int = 0
    weak_return: int = 0
    other_error: int = 0
    neighbours_invalid: int = 0
    amplitudes_differ: int = 0
    glitch: int = 0
    too_strong: int = 0


@dataclass(frozen=True, slots=True)
class LidarSensor:
    """What the twin must know of a lidar's receiver to make its readings from light.

    Attributes:
        min_range_mm: Shortest distance that is reported [mm].
        max_range_mm: Longest distance that is reported [mm].
        modulations: The two frequencies of a phase-shift sensor [Hz]: a beam that straddles a depth
            edge reads where their phasors point. None is a sensor by time of flight or
            triangulation: such a beam reads the mean of its light, and there is no cyclic error.
        codes: What is sent where there is no distance.
    """

    min_range_mm: int
    max_range_mm: int
    modulations: tuple[float, float] | None = None
    codes: ErrorCodes = field(default_factory=ErrorCodes)


@dataclass(frozen=True, kw_only=True)
class LidarDevice:
    """One lidar: its data sheet, its driver, its emulator.

    Attributes:
        name: By which it is chosen, as on the command line; the name of its entry point too.
        summary: One line for people.
        links: Names of the ways to connect it, the fastest first; each is a choice of
            ``lidar_link``, and the first is its default.
        spec: Returns the geometry of the lines that come over the named link.
        sensor: What the twin makes of its light.
        open_driver: Opens the lidar for a function that opens the line and is called again after
            the lidar was unplugged, a clock, and the name of a link; None is whatever the line
            carries. Raises ``LinkError`` where there is no such lidar.
        emulate: Returns a lidar's readings as a device on a line.
        usb_links: Those of ``links`` that are USB, where a bit rate means nothing.
        usb_ids: Makers by USB id, to find its port: ``15d1``, or with the product ``10c4:ea60``.
        bauds: Bit rates that its emulator can be powered up with, its own first.
        protocols: Protocols that its emulator can be powered up with, its own first.
        describe: Says in one line what an open driver knows of its device.
        options: What the configuration is for this lidar where nothing else is stated, by section:
            how it errs (``lidar``), say.
    """

    name: str
    summary: str
    links: tuple[str, ...]
    spec: Callable[[str], LidarSpec]
    sensor: LidarSensor
    open_driver: Callable[[Callable[[], Transport], Clock, str | None], LidarDriver]
    emulate: Callable[[Lidar, Wiring], Device]
    usb_links: tuple[str, ...] = ("usb",)
    usb_ids: Mapping[str, str] = field(default_factory=dict)
    bauds: tuple[int, ...] = ()
    protocols: tuple[str, ...] = ()
    describe: Callable[[Any], str] | None = None
    options: ConfigTables = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BaseDevice:
    """One drive base: its data sheet, its driver, its emulator.

    Attributes:
        name: By which it is chosen, such as ``create2``; the name of its entry point too.
        summary: One line for people.
        spec: The data sheet, which has the same name.
        open_driver: Opens the base on a line, for a clock and a guard that stops the wheels if this
            process cannot. Raises ``LinkError`` where there is no such base.
        emulate: Returns a base as a device on a line.
        usb_ids: Makers by USB id, to find its port: ``0403``, or with the product ``10c4:ea60``.
        halt: Stops the wheels; sent when the line was lost and is there again.
        farewell: Stops the wheels and leaves the base at rest, whatever was sent before; a guard
            process sends it if this process dies or hangs. Empty for a base that stops by itself.
        describe: Says in one line what an open driver knows of its device.
        inspect: Yields what else there is to say about an open driver's device.
        mjcf: The robot's body as an MJCF file with the names of ``assets/mjcf/create2.xml``; None
            is that file, with the wheels of ``spec``.
        counts: Whether odometry is by encoder counts; else by the commands that the driver sent.
        options: What the configuration is for this base where nothing else is stated, by section:
            how large it is (``motion``), say.
    """

    name: str
    summary: str
    spec: BaseSpec
    open_driver: Callable[[Transport, Clock, Guard | None], BaseDriver]
    emulate: Callable[[DriveBase], Device]
    usb_ids: Mapping[str, str] = field(default_factory=dict)
    halt: bytes = b""
    farewell: bytes = b""
    describe: Callable[[Any], str] | None = None
    inspect: Callable[[Any], Iterator[Finding]] | None = None
    mjcf: Path | None = None
    counts: bool = True
    options: ConfigTables = field(default_factory=dict)
