"""Opening the real robot: two serial ports behind the hardware interface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Literal, Protocol

from scan3d_twin.core.errors import ConfigError, LinkTimeoutError
from scan3d_twin.core.hal import Clock, Robot
from scan3d_twin.core.types import FloatArray
from scan3d_twin.devices.device import LidarDriver
from scan3d_twin.devices.links.guard import Guard, PortGuard
from scan3d_twin.devices.links.no_line import NoLine
from scan3d_twin.devices.links.scheduling import short_slices
from scan3d_twin.devices.links.transport import Reopening, SerialTransport, Tapped, Transport
from scan3d_twin.devices.registry import (
    DEFAULT_BASE,
    DEFAULT_LIDAR,
    Devices,
    base_device,
    lidar_device,
    turntable_device,
)
from scan3d_twin.real.clock import RealClock
from scan3d_twin.real.ports import refuse_same_port
from scan3d_twin.real.suspension import count_continuations

SLICE = 0.005
"""Interval at which the drivers are serviced while the robot's clock sleeps [s]."""


class Driver(Protocol):
    """A driver that must be serviced while time passes."""

    def service(self, now: float) -> None:
        """Take in what has arrived by ``now`` [s]; may raise, for example for a hazard."""
        ...


class ServicedClock:
    """The robot's clock: sleeping services the drivers, without threads."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._drivers: list[Driver] = []

    def attach(self, *drivers: Driver) -> None:
        """Service ``drivers`` from now on, in this order."""
        self._drivers += drivers

    def now(self) -> float:
        """See ``Clock.now``."""
        return self._clock.now()

    def sleep(self, seconds: float) -> None:
        """See ``Clock.sleep``."""
        deadline = self._clock.now() + seconds
        while True:
            for driver in self._drivers:
                driver.service(self._clock.now())
            left = deadline - self._clock.now()
            if left <= 1e-9:
                return
            self._clock.sleep(min(SLICE, left))


class Taps(Protocol):
    """Receives all bytes on the serial lines; an error raised by a tap ends the run."""

    def base(self, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """See ``transport.Tap``."""
        ...

    def lidar(self, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """See ``transport.Tap``."""
        ...

    def turntable(self, stamp: float, direction: Literal["<", ">"], data: bytes) -> None:
        """See ``transport.Tap``."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class CarriedTurntable:
    """A turntable between base and lidar.

    Attributes:
        name: Its name, see ``turntable_device``.
        open_line: Opens the line to it; called again after it was unplugged.
        T_base_axis: Pose of its axis, its z (4, 4).
        T_base_lidar: Pose of the lidar at its angle 0 (4, 4).
    """

    name: str
    open_line: Callable[[], Transport]
    T_base_axis: FloatArray
    T_base_lidar: FloatArray


@contextmanager
def open_over(
    base_link: Transport,
    open_lidar_link: Callable[[], Transport],
    clock: Clock,
    devices: Devices | None = None,
    guard: Guard | None = None,
    carried: CarriedTurntable | None = None,
) -> Iterator[Robot]:
    """Open the drivers on their lines; on every exit the wheels are stopped first.

    Args:
        base_link: The line to the base, ``NoLine`` for a stand; stays open.
        open_lidar_link: Opens the line to the lidar; called again after it was unplugged.
        clock: A clock that services no drivers.
        devices: Devices on the lines; None is the robot of the paper.
        guard: Stops the wheels if this process cannot.
        carried: The turntable that turns the lidar; None if the base does.

    Raises:
        LinkError: A device does not answer, or cannot deliver the lines wanted.
    """
    devices = Devices() if devices is None else devices
    open_lidar = lidar_device(devices.lidar).open_driver
    open_base = base_device(devices.base).opener(is_stated=devices.is_base_stated)
    serviced = ServicedClock(clock)
    with ExitStack() as stack:
        # Open the base last, so that it is closed first.
        lidar = stack.enter_context(closing(open_lidar(open_lidar_link, serviced, devices.link)))
        serviced.attach(lidar)
        table = None
        if carried is not None:
            open_table = turntable_device(carried.name).open_driver
            table = stack.enter_context(closing(open_table(carried.open_line, serviced)))
            serviced.attach(table)
        base = stack.enter_context(closing(open_base(base_link, serviced, guard)))
        serviced.attach(base)
        _forget_lines(lidar)
        if carried is None:
            yield Robot(base, lidar, serviced)
        else:
            mount = carried.T_base_lidar, table, carried.T_base_axis
            yield Robot(base, lidar, serviced, *mount)


def _forget_lines(lidar: LidarDriver) -> None:
    """Drop the lines that arrived while the base was being opened."""
    with suppress(LinkTimeoutError):
        while True:
            lidar.read_line(0.0)


def identify_base(link: Transport, clock: Clock, base: str | None) -> None:
    """See that the base is on a line, before anything is sent to what may be its line by mistake.

    Args:
        link: The line; stays open.
        clock: A clock that services no drivers.
        base: Name of the base; None finds it out.

    Raises:
        LinkError: There is no base on this line, or another one.
    """
    opener = base_device(base or DEFAULT_BASE).opener(is_stated=base is not None)
    opener(link, clock, None).close()


@contextmanager
def open_real(
    base_port: str | None,
    lidar_port: str,
    *,
    base: str | None = None,
    lidar: str = DEFAULT_LIDAR,
    link: str | None = None,
    taps: Taps | None = None,
    turntable: CarriedTurntable | None = None,
) -> Iterator[Robot]:
    """Open the robot on its serial ports; it does not move, and is stopped on every exit.

    Args:
        base_port: Port of the base, such as ``/dev/ttyUSB0``; None for a stand, which has none.
        lidar_port: Port of the lidar, such as ``/dev/ttyACM0``.
        base: Name of the base (``twin devices`` lists them); None finds out if it is a Create 1 or
            a Create 2.
        lidar: Name of the lidar.
        link: How the lidar is connected, one of its links; None is the first of them.
        taps: Receive every byte sent to base, lidar and turntable, and received.
        turntable: What turns the lidar; None if the base does.

    Raises:
        UnknownNameError: There is no such device or link.
        LinkError: A port cannot be opened, or the device on it does not answer or is another one;
            the message says what to do.

    >>> with s3d.open_real("/dev/ttyUSB9", "/dev/ttyACM9") as robot:
    ...     session = s3d.digitize(robot)
    Traceback (most recent call last):
    scan3d_twin.core.errors.LinkError: ...
    """
    # Devices and clock
    devices = Devices(
        base or DEFAULT_BASE,
        lidar,
        link or lidar_device(lidar).links[0],
        is_base_stated=base is not None,
    )
    device, clock = base_device(devices.base), RealClock()

    def open_lidar_link() -> Transport:
        line = SerialTransport(lidar_port)
        return line if taps is None else Tapped(line, clock, taps.lidar)

    carried = turntable if taps is None else tap_turntable(turntable, clock, taps)

    # A stand has neither port nor wheels
    if device.spec.is_stand:
        stand = open_over(NoLine(), open_lidar_link, clock, devices, None, carried)
        with short_slices(), stand as robot:
            yield robot
        return
    if base_port is None:
        raise ConfigError(f"the base {devices.base} has a port, and none is given")
    port = base_port
    refuse_same_port(port, lidar_port)
    stack = ExitStack()
    guard = PortGuard(device.farewell, clock, stack.enter_context(count_continuations()))

    def open_base_link() -> Transport:
        line = SerialTransport(port)
        guard.watch(line.fileno())
        return line if taps is None else Tapped(line, clock, taps.base)

    # Open the ports, then the drivers
    with stack:
        stack.enter_context(short_slices())
        stack.callback(guard.close)
        base_link = stack.enter_context(
            closing(Reopening(open_base_link, clock, device.halt, guard.close))
        )
        if turntable is not None or not lidar_device(lidar).sends_text:
            identify_base(base_link, clock, base)
        opening = open_over(base_link, open_lidar_link, clock, devices, guard, carried)
        yield stack.enter_context(opening)


def tap_turntable(
    turntable: CarriedTurntable | None, clock: Clock, taps: Taps
) -> CarriedTurntable | None:
    """Return ``turntable`` with its bytes passed to ``taps`` too."""
    if turntable is None:
        return None
    opening = turntable.open_line
    return replace(turntable, open_line=lambda: Tapped(opening(), clock, taps.turntable))
