"""How the firmware of an emulated RPLIDAR answers requests; no timing of the samples.

Sources: the protocol and the SDK named in ``codec``, and the order of requests in which the SDK,
pyrplidarsdk, pyrplidar, rplidar-roboticia, adafruit-circuitpython-rplidar and rplidarc1 connect.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

from scan3d_twin.core.errors import ProtocolError
from scan3d_twin.devices.rplidar import codec
from scan3d_twin.devices.rplidar.codec import (
    FIXED_POINT,
    Command,
    ConfKey,
    Descriptor,
    DeviceInfo,
    Health,
    ReplyType,
    Request,
    SampleRate,
)
from scan3d_twin.devices.rplidar.model import (
    FRAME_LENGTHS,
    STOP_PAUSE,
    Motor,
    RplidarModel,
    ScanMode,
    answers_conf,
)

SERIAL = bytes.fromhex("7CF1994EC1E2D0F1C7E69DF1A2B4 4B09")
"""Serial number of the emulated one; made up."""
ACC_BOARD_HAS_NO_PWM = 0
"""Answer to GET_ACC_BOARD_FLAG: the speed cannot be set by a pulse width."""


@dataclass(frozen=True, slots=True)
class RplidarProfile:
    """One RPLIDAR and its state when it is powered up.

    Attributes:
        firmware: Major and minor version; None is that of the model.
        health: Its health; after an error no scan starts until RESET, which mends it.
        is_broken: Whether the error comes back after each RESET.
        mode: Number of the typical mode that it states; None is that of the preferred link.
        is_turning: Whether its motor turns at power-up, as an A1's does without the line DTR.
    """

    firmware: tuple[int, int] | None = None
    health: Health = field(default_factory=lambda: Health(codec.GOOD))
    is_broken: bool = False
    mode: int | None = None
    is_turning: bool = True


class Firmware:
    """The state of the lidar, and its answers.

    Attributes:
        model: The kind of lidar.
        mode: The scan that is running; None when idle.
        scan_from: Time from which samples are sent [s].
        deaf_until: Time until which it does not listen [s], after RESET.
        busy_until: Time until which it takes no request [s], after STOP.
    """

    def __init__(self, model: RplidarModel, profile: RplidarProfile) -> None:
        self.model = model
        self.mode: ScanMode | None = None
        self.scan_from = 0.0
        self.deaf_until = self.busy_until = 0.0
        self._asked_at = 0.0
        self._profile = profile
        self._firmware = profile.firmware or model.firmware
        self._health = profile.health
        self._turning_since: float | None = -model.spin_up if profile.is_turning else None
        self._handlers: dict[int, Callable[[Request, float], bytes]] = {
            Command.STOP: self._stop,
            Command.RESET: self._reset,
            Command.SCAN: self._scan,
            Command.FORCE_SCAN: self._scan,
            Command.EXPRESS_SCAN: self._express_scan,
            Command.GET_INFO: self._info,
            Command.GET_HEALTH: self._get_health,
            Command.GET_SAMPLERATE: self._sample_rate,
            Command.GET_LIDAR_CONF: self._conf,
            Command.SET_MOTOR_RPM: self._set_speed,
            Command.GET_ACC_BOARD_FLAG: self._acc_board,
        }

    @property
    def is_turning(self) -> bool:
        """Whether the motor is running."""
        return self._turning_since is not None

    def answer(self, request: Request, now: float) -> bytes:
        """Return the reply to a request received at ``now`` [s]; b"" if there is none."""
        handler = self._handlers.get(request.command)
        return b"" if handler is None or now < self.busy_until else handler(request, now)

    def set_motor(self, running: bool, now: float) -> None:
        """Start or stop the motor at ``now`` [s]; without it no samples are sent."""
        if running and not self.is_turning:
            self._turning_since = now
        elif not running:
            self._turning_since = None
        self.scan_from = max(self._asked_at, self._stable_at())

    def _stable_at(self) -> float:
        """Return when the rotation is stable [s]; never while the motor is not turning."""
        if self._turning_since is None:
            return float("inf")
        return self._turning_since + self.model.spin_up

    def _stop(self, request: Request, now: float) -> bytes:
        self.mode = None
        self.busy_until = now + STOP_PAUSE
        if self.model.motor is Motor.SCAN:
            self.set_motor(False, now)
        return b""

    def _reset(self, request: Request, now: float) -> bytes:
        self._stop(request, now)
        self.deaf_until = now + self.model.boot
        if not self._profile.is_broken:
            self._health = Health(codec.GOOD)
        return self.model.boot_text

    def _scan(self, request: Request, now: float) -> bytes:
        return self._start(0, now, forced=request.command == Command.FORCE_SCAN)

    def _express_scan(self, request: Request, now: float) -> bytes:
        if len(request.payload) != 5:
            return b""
        # Mode 0 is the express scan of all firmwares, where there is one
        express = (m for m in self.model.modes.values() if m.reply is ReplyType.EXPRESS)
        legacy = next((m.number for m in express), 0)
        return self._start(request.payload[0] or legacy, now)

    def _start(self, number: int, now: float, forced: bool = False) -> bytes:
        """Start the scan mode ``number``; return its descriptor."""
        mode = self._mode(number)
        if mode is None or self._health.status == codec.ERROR:
            return b""
        self.mode = mode
        # What starts the motor of an S2 or C1 is the scan, unless it turns already
        if self.model.motor is not Motor.DTR:
            self.set_motor(True, now)
        self._asked_at = now
        self.scan_from = now if forced else max(now, self._stable_at())
        return Descriptor(FRAME_LENGTHS[mode.reply], True, mode.reply).encode()

    def _mode(self, number: int) -> ScanMode | None:
        modes = self.model.modes.values()
        return next((mode for mode in modes if mode.number == number), None)

    def _info(self, request: Request, now: float) -> bytes:
        info = DeviceInfo(self.model.model, self._firmware, self.model.hardware, SERIAL)
        return codec.encode_reply(ReplyType.INFO, info.encode())

    def _get_health(self, request: Request, now: float) -> bytes:
        return codec.encode_reply(ReplyType.HEALTH, self._health.encode())

    def _sample_rate(self, request: Request, now: float) -> bytes:
        times = [round(mode.sample_us) for mode in self.model.modes.values()]
        return codec.encode_reply(ReplyType.SAMPLERATE, SampleRate(max(times), min(times)).encode())

    def _acc_board(self, request: Request, now: float) -> bytes:
        return codec.encode_reply(ReplyType.ACC_BOARD_FLAG, struct.pack("<I", ACC_BOARD_HAS_NO_PWM))

    def _set_speed(self, request: Request, now: float) -> bytes:
        if self.model.motor is Motor.SPEED and len(request.payload) == 2:
            self.set_motor(request.payload != bytes(2), now)
        return b""

    def _conf(self, request: Request, now: float) -> bytes:
        if not answers_conf(self.model.model, self._firmware):
            return b""
        try:
            key, number = codec.decode_conf_request(request.payload)
        except ProtocolError:
            return b""
        value = self._conf_value(key, self._mode(number))
        if value is None:
            return b""
        return codec.encode_reply(ReplyType.LIDAR_CONF, codec.encode_conf_reply(key, value))

    def _conf_value(self, key: int, mode: ScanMode | None) -> bytes | None:
        """Return the entry ``key``, of ``mode`` where it has one; None if there is none."""
        numbers = [each.number for each in self.model.modes.values()]
        typical = numbers[0] if self._profile.mode is None else self._profile.mode
        rpm = self.model.rpm
        values = {
            ConfKey.MODE_COUNT: struct.pack("<H", 1 + max(numbers)),
            ConfKey.TYPICAL_MODE: struct.pack("<H", typical),
            ConfKey.WANTED_SPEED: struct.pack("<HH", rpm, 0),
            ConfKey.MIN_RPM: struct.pack("<H", round(60 * self.model.slowest_turns)),
            ConfKey.MAX_RPM: struct.pack("<H", 2 * rpm),
        }
        if mode is not None:
            values |= {
                ConfKey.MODE_US_PER_SAMPLE: struct.pack("<I", round(FIXED_POINT * mode.sample_us)),
                ConfKey.MODE_MAX_DISTANCE: struct.pack("<I", round(FIXED_POINT * mode.reach_m)),
                ConfKey.MODE_REPLY_TYPE: bytes([mode.reply]),
                ConfKey.MODE_NAME: mode.name.encode() + b"\0",
            }
        return values.get(ConfKey(key)) if key in list(ConfKey) else None
