"""Finding an XL330 on a line, and making it ready to turn."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.core.hal import Clock
from scan3d_twin.devices.dynamixel import model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.link import ATTEMPTS, ServoLink, Steps
from scan3d_twin.devices.links.transport import Transport

SEARCHED_BAUDS = (1_000_000, 57600, 2_000_000, 115200, 3_000_000, 4_000_000, 9600)
"""Bit rates at which a servo is looked for, the most likely first [bit/s]."""
PINGS = 2
"""Number of times that a servo is called at each bit rate."""
PIECE = 16
"""Bytes of the EEPROM that are read at once."""
BOOT = 0.5
"""Time after a reboot in which it is not asked [s]; assumption."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServoInfo:
    """What a servo says about itself.

    Attributes:
        id: Its id.
        baud: Its bit rate [bit/s].
        model_number: Its model number.
        firmware: Version of its firmware.
        max_velocity: Its velocity limit [0.229 rev/min].
        positions: Its smallest and largest position [counts]: those that are set in it, or as far
            as the cable allows.
        is_on: Whether its torque was on.
        voltage: Supply voltage [V].
        temperature: Its temperature [degC].
    """

    id: int
    baud: int
    model_number: int
    firmware: int
    max_velocity: int
    positions: tuple[int, int]
    is_on: bool
    voltage: float
    temperature: int


@dataclass(frozen=True, slots=True)
class Place:
    """Where a servo was found: its id and its bit rate [bit/s]."""

    id: int
    baud: int


def find_servo(
    transport: Transport, clock: Clock, known: Place | None
) -> Steps[tuple[ServoLink, int]]:
    """Return the link to the only XL330 on a line, and its id.

    Args:
        transport: The line.
        clock: The robot's clock.
        known: Where it was before; None looks everywhere.

    Raises:
        LinkError: There is none, or more than one.
    """
    bauds = SEARCHED_BAUDS if known is None else (known.baud,)
    servo = model.FACTORY_ID if known is None else known.id
    supported = []
    for baud in bauds:
        try:
            link = ServoLink(transport, clock, baud)
        except LinkError:
            continue
        supported.append(baud)
        try:
            yield from link.ping(servo, PINGS if known is None else ATTEMPTS)
        except LinkTimeoutError:
            continue
        return link, servo
    if known is not None:
        raise LinkTimeoutError(f"the servo {servo} does not answer at {known.baud} baud")
    return (yield from _find_any(transport, clock, supported))


def _find_any(
    transport: Transport, clock: Clock, bauds: Sequence[int]
) -> Steps[tuple[ServoLink, int]]:
    """Return the link to the only servo, whatever its id."""
    found = []
    for baud in bauds:
        answers = yield from ServoLink(transport, clock, baud).find_all()
        found += [Place(servo, baud) for servo in answers]
    if not found:
        tried = ", ".join(map(str, bauds))
        raise LinkTimeoutError(
            f"no Dynamixel answers at {tried} baud: is its 5 V supply on, and its cable plugged in "
            "at both ends?"
        )
    if len(found) > 1:
        each = ", ".join(f"{place.id} at {place.baud} baud" for place in found)
        raise LinkError(f"several servos are on the line ({each}): leave one, or give it the id 1")
    return ServoLink(transport, clock, found[0].baud), found[0].id


def prepare_servo(link: ServoLink, servo: int) -> Steps[ServoInfo]:
    """Set up the servo for motions to positions; it does not move.

    It may turn over several turns, as far as the cable of what it carries allows, unless position
    limits are set in it. The EEPROM, which wears out, is written only where it must be.

    Raises:
        LinkError: It is no XL330, has a hardware error that stays, or does not answer.
    """
    # Mode, limits and return delay
    yield from link.let_answer(servo)
    eeprom = yield from _read_eeprom(link, servo)
    number = reg.MODEL_NUMBER.find_in(eeprom, 0)
    if number not in model.MODELS:
        known = " or ".join(f"{title} ({number})" for number, title in model.MODELS.items())
        raise LinkError(f"the servo {servo} is of model {number}, not {known}: use one of these")
    is_on = yield from _check_health(link, servo)
    limits = reg.MIN_POSITION.find_in(eeprom, 0), reg.MAX_POSITION.find_in(eeprom, 0)
    is_limited = limits != (reg.MIN_POSITION.default, reg.MAX_POSITION.default)
    mode = model.POSITION_MODE if is_limited else model.MULTI_TURN_MODE
    is_on = (yield from _set_up(link, servo, eeprom, mode)) and is_on

    # A guard that has expired locks the goals
    yield from link.write(servo, reg.BUS_WATCHDOG, 0)
    start = reg.PRESENT_VOLTAGE.address
    state = (yield from link.read(servo, start, reg.PRESENT_TEMPERATURE.end)).data
    reach = math.floor(model.CABLE_LIMIT / model.COUNT)
    return ServoInfo(
        id=servo,
        baud=link.baud,
        model_number=number,
        firmware=reg.FIRMWARE_VERSION.find_in(eeprom, 0),
        max_velocity=reg.VELOCITY_LIMIT.find_in(eeprom, 0),
        positions=limits if is_limited else (model.MIDDLE - reach, model.MIDDLE + reach),
        is_on=is_on,
        voltage=reg.PRESENT_VOLTAGE.find_in(state, start) * model.VOLTAGE_UNIT,
        temperature=reg.PRESENT_TEMPERATURE.find_in(state, start),
    )


def _read_eeprom(link: ServoLink, servo: int) -> Steps[bytes]:
    """Return the EEPROM in short pieces, of which a bad line lets more through."""
    pieces = []
    for start in range(0, reg.RAM, PIECE):
        pieces.append((yield from link.read(servo, start, start + PIECE)).data)
    return b"".join(pieces)


def _set_up(link: ServoLink, servo: int, eeprom: bytes, mode: int) -> Steps[bool]:
    """Set operating ``mode``, drive mode, return delay; return if the torque is as before."""
    drive = reg.DRIVE_MODE.find_in(eeprom, 0)
    wanted = {
        reg.OPERATING_MODE: mode,
        reg.DRIVE_MODE: drive & ~model.TIME_BASED,
        reg.RETURN_DELAY: 0,
    }
    changes = {each: v for each, v in wanted.items() if each.find_in(eeprom, 0) != v}
    if changes:
        yield from link.write(servo, reg.TORQUE, 0)
    for register, value in changes.items():
        yield from link.write(servo, register, value)
    return not changes


def _check_health(link: ServoLink, servo: int) -> Steps[bool]:
    """End a hardware error by a reboot; return whether the torque is on.

    Raises:
        LinkError: The error comes back.
    """
    is_on, bits = yield from read_health(link, servo)
    if not bits:
        return is_on
    _log.warning("the turntable stopped because %s; starting it anew", explain_errors(bits)[0])
    yield from link.reboot(servo)
    until = link.clock.now() + BOOT
    while link.clock.now() < until:
        yield
    yield from link.let_answer(servo)
    is_on, bits = yield from read_health(link, servo)
    if bits:
        reason, cure = explain_errors(bits)
        raise LinkError(f"the turntable does not work: {reason}; {cure}")
    return is_on


def read_health(link: ServoLink, servo: int) -> Steps[tuple[bool, int]]:
    """Return whether the torque is on, and the hardware errors."""
    start = reg.TORQUE.address
    block = (yield from link.read(servo, start, reg.HARDWARE_ERROR.end)).data
    is_on = bool(reg.TORQUE.find_in(block, start))
    return is_on, reg.HARDWARE_ERROR.find_in(block, start)


def explain_errors(bits: int) -> tuple[str, str]:
    """Return the reason and the cure of hardware errors."""
    known = [text for bit, text in model.HARDWARE_ERRORS.items() if bits >> bit & 1]
    if not known:
        return f"of the unknown hardware error {bits:#04x}", "power it off and on"
    return " and ".join(reason for reason, _ in known), "; ".join(cure for _, cure in known)
