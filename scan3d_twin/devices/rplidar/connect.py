"""Connecting to an RPLIDAR in whatever state it was left: stop, identify, choose how to scan.

Only requests that every RPLIDAR knows are sent before the lidar has said which one it is.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from scan3d_twin.core.errors import LinkError, LinkTimeoutError
from scan3d_twin.devices.reconnecting import Steps, T
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.codec import (
    FIXED_POINT,
    MAX_REQUEST,
    Command,
    ConfKey,
    DeviceInfo,
    Health,
    ReplyType,
    SampleRate,
    encode_request,
)
from scan3d_twin.devices.rplidar.link import RplidarLink
from scan3d_twin.devices.rplidar.model import (
    FRAME_LENGTHS,
    MODELS,
    Motor,
    RplidarModel,
    ScanMode,
    answers_conf,
)

BOOT = 2.5
"""Time after RESET until it is spoken to again [s]: an S1 is deaf for 2 s (ardupilot#14527)."""
MOTOR_LEAD = 1.0
"""Time from the start of an S2's motor until a scan is asked for [s]; without it the scan fails
(rplidar_ros#73)."""
START_ATTEMPTS = 3
"""Number of times a scan is asked for."""
START_TIMEOUT = 0.5
"""Time-out for the descriptor of a scan [s]; assumption."""
MAX_MODES = 16
"""Most scan modes that are looked at; an A1 has up to 5."""
SAMPLE_TIMES_US = (10.0, 1000.0)
"""Shortest and longest plausible time per sample [us]."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RplidarInfo:
    """What the lidar says about itself.

    Attributes:
        device: Model, firmware, hardware and serial number.
        health: Its health.
        mode: The scan mode that is used, as it states it.
    """

    device: DeviceInfo
    health: Health
    mode: ScanMode


def identify(link: RplidarLink, model: RplidarModel) -> Steps[tuple[DeviceInfo, Health]]:
    """Stop the lidar and read what it is and how it is; a protection stop is ended by RESET.

    Raises:
        LinkError: It is another lidar, or reports an error that RESET does not mend.
    """
    device = yield from _find(link, model)
    if device.major_id != model.major_id:
        known = MODELS.get(device.major_id)
        found = f"model byte {device.model:#x}" if known is None else known.title
        cure = "" if known is None else f": use --lidar {known.name}"
        raise LinkError(f"this lidar is no {model.title} but {found}{cure}")

    # End a protection stop
    health = yield from _health(link)
    if health.status == codec.ERROR:
        _log.warning("the lidar reports the error %#06x, resetting it", health.code)
        link.send(encode_request(Command.RESET))
        yield from link.wait(BOOT)
        yield from link.stop_scan()
        health = yield from _health(link)
    if health.status == codec.ERROR:
        raise LinkError(
            f"the lidar reports the error {health.code:#06x}: see that its head turns freely, then "
            "power it off and on"
        )
    if health.status == codec.WARNING:
        _log.warning("the lidar reports the warning %#06x", health.code)
    return device, health


def _find(link: RplidarLink, model: RplidarModel) -> Steps[DeviceInfo]:
    """Silence the lidar and return what it says it is.

    Raises:
        LinkError: There is none.
    """
    silent = yield from link.stop_scan()
    request = encode_request(Command.GET_INFO)
    with suppress(LinkTimeoutError):
        return (yield from link.ask(request, ReplyType.INFO, codec.decode_info, attempts=3))
    try:
        # It may wait for the rest of a request: zeros complete any, and begin none
        link.send(bytes(MAX_REQUEST))
        yield from link.stop_scan()
        return (yield from link.ask(request, ReplyType.INFO, codec.decode_info))
    except LinkTimeoutError:
        why = "nothing is answered" if silent else "it does not stop sending"
        raise LinkTimeoutError(
            f"no {model.title} answers at {model.baud} baud ({why}): check its power (5 V), the "
            "cable, and that this is the lidar's port"
        ) from None


def _health(link: RplidarLink) -> Steps[Health]:
    request = encode_request(Command.GET_HEALTH)
    return (yield from link.ask(request, ReplyType.HEALTH, codec.decode_health))


def choose_mode(
    link: RplidarLink, device: DeviceInfo, wanted: Iterable[ScanMode]
) -> Steps[ScanMode]:
    """Return the first of the ``wanted`` modes that the lidar has, as it states it.

    Raises:
        LinkError: It has none of them.
    """
    wanted = tuple(wanted)
    if not answers_conf(device.model, device.firmware):
        return (yield from _plain_mode(link, wanted[0]))
    stated = yield from _stated_modes(link)
    for mode in wanted:
        found = next((each for each in stated if each.reply == mode.reply), None)
        if found is not None:
            return found
    names = ", ".join(f"{mode.name} ({mode.reply:#x})" for mode in stated) or "none"
    raise LinkError(
        f"this lidar cannot send {' or '.join(mode.name for mode in wanted)}; it states the scan "
        f"modes {names}: choose another --lidar-link"
    )


def _plain_mode(link: RplidarLink, mode: ScanMode) -> Steps[ScanMode]:
    """Return ``mode`` of an old firmware, which knows the standard and the express scan."""
    request = encode_request(Command.GET_SAMPLERATE)
    rate: SampleRate
    rate = yield from link.ask(request, ReplyType.SAMPLERATE, codec.decode_sample_rate)
    us = rate.standard_us if mode.reply is ReplyType.NODES else rate.express_us
    return replace(mode, number=0, sample_us=float(us))


def _stated_modes(link: RplidarLink) -> Steps[list[ScanMode]]:
    """Return the scan modes that the lidar states, as far as they can be decoded."""
    count = yield from _number(link, ConfKey.MODE_COUNT)
    modes = []
    for number in range(min(count, MAX_MODES)):
        try:
            reply = yield from _number(link, ConfKey.MODE_REPLY_TYPE, number)
            us = (yield from _number(link, ConfKey.MODE_US_PER_SAMPLE, number)) / FIXED_POINT
            reach = (yield from _number(link, ConfKey.MODE_MAX_DISTANCE, number)) / FIXED_POINT
            name = yield from _conf(link, ConfKey.MODE_NAME, number, codec.decode_name)
        except LinkTimeoutError:
            continue
        if reply in FRAME_LENGTHS and SAMPLE_TIMES_US[0] <= us <= SAMPLE_TIMES_US[1]:
            modes.append(ScanMode(name, number, ReplyType(reply), us, reach))
    return modes


def _number(link: RplidarLink, key: ConfKey, mode: int | None = None) -> Steps[int]:
    return (yield from _conf(link, key, mode, codec.decode_number))


def _conf(
    link: RplidarLink, key: ConfKey, mode: int | None, decode: Callable[[bytes], T]
) -> Steps[T]:
    request = codec.encode_conf_request(key, mode)
    return (
        yield from link.ask(
            request,
            ReplyType.LIDAR_CONF,
            lambda payload: decode(codec.decode_conf_reply(payload, key)),
        )
    )


def start_scan(link: RplidarLink, model: RplidarModel, mode: ScanMode) -> Steps[None]:
    """Start motor and scan.

    Raises:
        LinkTimeoutError: The lidar does not start.
    """
    if model.motor is Motor.SPEED:
        link.send(codec.encode_motor_rpm(model.rpm))
        yield from link.wait(MOTOR_LEAD)
    if mode.reply is ReplyType.NODES:
        request = encode_request(Command.SCAN)
    else:
        request = codec.encode_express_scan(mode.number)
    for attempt in range(START_ATTEMPTS):
        try:
            yield from link.start(request, mode.reply, FRAME_LENGTHS[mode.reply], START_TIMEOUT)
            return
        except LinkTimeoutError:
            if attempt + 1 == START_ATTEMPTS:
                raise
            yield from link.stop_scan()
