"""Descriptions of devices: all that the rest of the package knows about a lidar, base or turntable.

Each family of devices is one folder with the same files: ``model.py`` (the numbers of the data
sheet, with their sources), ``codec.py`` (bytes to values and back), ``driver.py``, ``emulator.py``,
and ``device.py``, which describes the devices of the family by the classes below. ``registry``
finds the descriptions by name, including those of other packages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from scan3d_twin.core.hal import BaseSpec, Clock, DriveBase, Lidar, Turntable, TurntableSpec
from scan3d_twin.core.types import LidarSpec

if TYPE_CHECKING:
    from scan3d_twin.devices.links.guard import Guard
    from scan3d_twin.devices.links.line_model import Device
    from scan3d_twin.devices.links.transport import Transport

ConfigTables = Mapping[str, Mapping[str, Any]]
"""Options by section and name, as in a configuration file."""


class LidarDriver(Lidar, Protocol):
    """A ``Lidar`` over a serial line."""

    @property
    def bad(self) -> int:
        """Number of scan lines and other blocks that arrived damaged."""
        ...

    def service(self, now: float) -> None:
        """Take in what has arrived by ``now`` [s], without waiting."""
        ...

    def close(self) -> None:
        """Stop the lidar and close its port."""
        ...


class BaseDriver(DriveBase, Protocol):
    """A ``DriveBase`` over a serial line."""

    @property
    def bad(self) -> int:
        """Number of readings that arrived damaged."""
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


class TurntableDriver(Turntable, Protocol):
    """A ``Turntable`` over a serial line."""

    @property
    def bad(self) -> int:
        """Number of angles that are missing or arrived damaged."""
        ...

    def service(self, now: float) -> None:
        """Take in what has arrived by ``now`` [s], without waiting.

        Raises:
            HazardError: The turntable has switched its torque off.
        """
        ...

    def close(self) -> None:
        """Stop the turntable, leave it at rest, and close its port."""
        ...


BaseOpener: TypeAlias = "Callable[[Transport, Clock, Guard | None], BaseDriver]"
"""Opens a base on a line; the clock times it, and the guard stops the wheels if we cannot."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One line in the report of ``twin doctor``.

    Attributes:
        what: The thing that was checked.
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
        usb: Whether it is on USB, where the bit rate has no effect.
        baud: Bit rate after power-up [bit/s]; None is the device's default.
        protocol: Protocol after power-up; None is the device's default.
    """

    usb: bool = True
    baud: int | None = None
    protocol: str | None = None


@dataclass(frozen=True, slots=True)
class ErrorCodes:
    """The codes that a lidar sends in place of a distance, by cause."""

    no_return: int = 0
    weak_return: int = 0
    other_error: int = 0
    neighbours_invalid: int = 0
    amplitudes_differ: int = 0
    glitch: int = 0
    too_strong: int = 0
    too_far: int = 0


@dataclass(frozen=True, slots=True)
class LidarSensor:
    """The receiver of a lidar, as needed to simulate its readings.

    Attributes:
        min_range_mm: Shortest distance that is reported [mm].
        max_range_mm: Longest distance that is reported [mm].
        modulations: The two modulation frequencies of a phase-shift sensor [Hz]: a beam that
            straddles a depth edge reads the distance given by the sum of the phasors. None is a
            sensor by time of flight or triangulation: such a beam reads the mean of its light, and
            there is no cyclic error.
        codes: Codes sent in place of a distance.
        detected_range_mm: Distance beyond which a detected return has the code ``too_far`` [mm];
            from ``max_range_mm`` up to it, ``no_return``.
        drops_isolated: Whether it drops a reading whose neighbours on both sides are invalid.
    """

    min_range_mm: int
    max_range_mm: int
    modulations: tuple[float, float] | None = None
    codes: ErrorCodes = field(default_factory=ErrorCodes)
    detected_range_mm: int = 1_000_000
    drops_isolated: bool = True


@dataclass(frozen=True, slots=True)
class LidarProbe:
    """How a family of lidars is recognised on a line on which any other lidar may be.

    Attributes:
        bauds: Bit rates at which it may be found, the most likely first [bit/s].
        recognise: Returns the name of the device that sent some bytes, read at one of ``bauds``;
            None if they are from none of this family.
        request: Bytes to which it answers in any state. They must not harm a lidar of any other
            family, nor change more of its own than that it stops scanning; empty for a lidar that
            sends by itself.
        wait: Time in which enough bytes arrive [s].
        stop: Bytes as harmless that end what it was doing, sent before ``request``.
        pause: Time between the two [s].
        explain: Returns what is known of bytes that ``recognise`` does not know, such as those of a
            lidar of this family that is not supported; None if nothing.
    """

    bauds: tuple[int, ...]
    recognise: Callable[[bytes], str | None]
    request: bytes = b""
    wait: float = 0.15
    stop: bytes = b""
    pause: float = 0.0
    explain: Callable[[bytes], str | None] | None = None


@dataclass(frozen=True, kw_only=True)
class LidarDevice:
    """One lidar: its data sheet, its driver, its emulator.

    Attributes:
        name: Name by which it is chosen, as on the command line; also that of its entry point.
        summary: One-line description.
        links: Names of the ways to connect it, the fastest first, which is the default;
            the choices of ``lidar_link``.
        spec: Returns the geometry of the scan lines received over the named link.
        sensor: Its receiver, for the twin.
        open_driver: Opens the lidar. Its arguments are a function that opens the line, called again
            after the lidar was unplugged; a clock; and the name of a link, None for whatever the
            line carries. Raises ``LinkError`` if there is no such lidar.
        emulate: Returns an emulated device that serves the readings of a ``Lidar``.
        usb_links: Those of ``links`` that are USB, where a bit rate means nothing.
        usb_ids: Makers by USB id, to find its port: ``15d1``, or with the product ``10c4:ea60``.
        bauds: Bit rates that its emulator can power up with, the default first.
        protocols: Protocols that its emulator can power up with, the default first.
        sample_rate: Returns the readings per second over the named link [Hz] of a lidar that turns
            all round and takes them by a clock of its own, whatever its speed: they lie elsewhere
            in each revolution. The ``elevations`` of its ``spec`` are then a grid for them
            (``make_full_circle``). None for a lidar that measures at fixed angles.
        sends_text: Whether its driver sends ASCII only, or nothing: no byte of that is a command to
            a base. Of another one the base is identified before the lidar's port is opened, since
            the ports may be mixed up: STOP of an RPLIDAR presses Clean of a Create 2.
        probe: Recognises it among the lidars of all families, for ``--lidar auto``; one object for
            all devices of a family. None if it must be named.
        describe: Returns a one-line description of the device behind an open driver.
        options: Defaults of the configuration for this lidar, by section; for example its errors
            (``lidar``).
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
    sample_rate: Callable[[str], float] | None = None
    sends_text: bool = False
    probe: LidarProbe | None = None
    describe: Callable[[Any], str] | None = None
    options: ConfigTables = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BaseDevice:
    """One drive base: its data sheet, its driver, its emulator.

    Attributes:
        name: Name by which it is chosen, such as ``create2``; also that of its entry point and of
            ``spec``.
        summary: One-line description.
        spec: The data sheet.
        open_driver: Opens the base on a line. Its other arguments are a clock and a guard that
            stops the wheels if this process cannot. Raises ``LinkError`` if there is no such base.
        emulate: Returns an emulated device that moves a ``DriveBase``.
        open_stated: Like ``open_driver``, which may find another base of the same family, but for a
            user who has stated this one: decides where the base's answers do not, and raises
            ``LinkError`` where they contradict. None where ``open_driver`` knows only this base.
        usb_ids: Makers by USB id, to find its port: ``0403``, or with the product ``10c4:ea60``.
        halt: Bytes that stop the wheels; sent when a lost line is open again.
        farewell: Bytes that stop the wheels and leave the base at rest, whatever was sent before; a
            guard process sends them if this process dies or hangs. Empty for a base with a watchdog
            of its own.
        describe: Returns a one-line description of the device behind an open driver.
        inspect: Yields further findings about the device behind an open driver.
        mjcf: The robot's body as an MJCF file with the names of ``assets/mjcf/create2.xml``; None
            is that file, with the body and the wheels of ``spec``.
        counts: Whether odometry comes from encoder counts; otherwise from the drive commands.
        options: Defaults of the configuration for this base, by section; for example its size
            (``motion``).
    """

    name: str
    summary: str
    spec: BaseSpec
    open_driver: BaseOpener
    emulate: Callable[[DriveBase], Device]
    open_stated: BaseOpener | None = None
    usb_ids: Mapping[str, str] = field(default_factory=dict)
    halt: bytes = b""
    farewell: bytes = b""
    describe: Callable[[Any], str] | None = None
    inspect: Callable[[Any], Iterator[Finding]] | None = None
    mjcf: Path | None = None
    counts: bool = True
    options: ConfigTables = field(default_factory=dict)

    def opener(self, *, is_stated: bool) -> BaseOpener:
        """Return what opens this base where the user has stated it, or has not."""
        return self.open_stated if is_stated and self.open_stated else self.open_driver


@dataclass(frozen=True, kw_only=True)
class TurntableDevice:
    """One turntable: its data sheet, its driver, its emulator.

    Attributes:
        name: Name by which it is chosen, such as ``xl330``; also that of its entry point and of
            ``spec``.
        summary: One-line description.
        spec: The data sheet.
        open_driver: Opens the turntable, which does not move. Its arguments are a function that
            opens the line, called again after it was unplugged, and a clock. Raises ``LinkError``
            if there is no such turntable.
        emulate: Returns an emulated device that moves a ``Turntable``.
        usb_ids: Makers by USB id, to find its port: ``0403:6014``.
        describe: Returns a one-line description of the device behind an open driver.
        inspect: Yields further findings about the device behind an open driver.
        options: Defaults of the configuration for this turntable, by section.
    """

    name: str
    summary: str
    spec: TurntableSpec
    open_driver: Callable[[Callable[[], Transport], Clock], TurntableDriver]
    emulate: Callable[[Turntable], Device]
    usb_ids: Mapping[str, str] = field(default_factory=dict)
    describe: Callable[[Any], str] | None = None
    inspect: Callable[[Any], Iterator[Finding]] | None = None
    options: ConfigTables = field(default_factory=dict)
