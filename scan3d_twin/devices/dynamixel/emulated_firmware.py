"""How the firmware of an emulated XL330 keeps its control table and answers instructions.

Source: the manual named in ``model``. Where it is silent the answer is an assumption, and said so.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from scan3d_twin.devices.dynamixel import codec, model
from scan3d_twin.devices.dynamixel import registers as reg
from scan3d_twin.devices.dynamixel.codec import ErrorNumber, Instruction, Packet
from scan3d_twin.devices.dynamixel.emulated_motor import Motor
from scan3d_twin.devices.dynamixel.registers import Register

BOOT = 0.25
"""Time after a reboot in which it is deaf [s]; assumption."""
PING_SLOT = 0.001
"""Time that a servo waits for each id before its own when all are pinged [s]; assumption, the SDK
allows 3 ms."""
CLEAR_KEY = b"\x01\x44\x58\x4c\x22"
"""Parameters of the instruction that clears whole turns."""
KEEP_ALL, KEEP_ID, KEEP_ID_AND_BAUD = 0xFF, 0x01, 0x02
"""Parameters of a factory reset: what is reset is all, or all but what is named."""


@dataclass(frozen=True, slots=True)
class ServoProfile:
    """One servo and its state when it is powered up.

    Attributes:
        id: Its id.
        baud: Its bit rate [bit/s].
        model_number: Its model number.
        firmware: Version of its firmware.
        torque: Whether its torque is on, as a program leaves it that was killed.
        hardware_error: Content of the register of that name.
        broken: Whether the error comes back after a reboot.
        echo: Whether the adapter echoes what it sends, as some half-duplex ones do.
        voltage: Supply voltage [V].
        temperature: Its temperature [degC].
        tick_ms: Its timer at time 0 [ms].
        skew: Clock skew, positive if its clock is fast.
    """

    id: int = model.FACTORY_ID
    baud: int = model.FACTORY_BAUD
    model_number: int = model.M288
    firmware: int = model.FIRMWARE
    torque: bool = False
    hardware_error: int = 0
    broken: bool = False
    echo: bool = False
    voltage: float = 5.0
    temperature: int = 32
    tick_ms: int = 0
    skew: float = 0.0


@dataclass(frozen=True, slots=True)
class Reply:
    """A status packet.

    Attributes:
        data: Its bytes.
        wait: Time that it waits beyond the return delay [s].
    """

    data: bytes
    wait: float = 0.0


class RefusedError(Exception):
    """The servo refuses an instruction."""

    def __init__(self, number: ErrorNumber) -> None:
        super().__init__(number.name)
        self.number = number


class ServoFirmware:
    """The control table of the servo, and its answers.

    Attributes:
        profile: What it is, and its state at power-up.
        deaf_until: Time until which it does not listen [s].
    """

    def __init__(self, motor: Motor, profile: ServoProfile) -> None:
        self.profile = profile
        self.deaf_until = 0.0
        self._motor = motor
        self._table = bytearray(reg.SIZE)
        self._registered: tuple[int, bytes] | None = None
        self._heard = 0.0
        self._forgotten = 0
        self._handlers: dict[int, Callable[[Packet, float], bytes]] = {
            Instruction.PING: self._ping,
            Instruction.READ: self._read,
            Instruction.WRITE: self._write,
            Instruction.REG_WRITE: self._register_write,
            Instruction.ACTION: self._action,
            Instruction.FACTORY_RESET: self._factory_reset,
            Instruction.REBOOT: self._reboot,
            Instruction.CLEAR: self._clear,
        }
        self._reset(0)
        self.put(reg.ID, profile.id)
        self.put(reg.BAUD_RATE, model.BAUDS.index(profile.baud))
        self.put(reg.HARDWARE_ERROR, profile.hardware_error)
        self.put(reg.GOAL_POSITION, self._position(0.0))
        self.put(reg.TORQUE, int(profile.torque))

    def get(self, register: Register) -> int:
        """Return the content of a ``register``."""
        return register.decode(self._table[register.address : register.end])

    def put(self, register: Register, value: int) -> None:
        """Store a ``value``, whether a program may or not."""
        self._table[register.address : register.end] = register.encode(value)

    @property
    def baud(self) -> int:
        """The bit rate in the table [bit/s]."""
        return model.BAUDS[self.get(reg.BAUD_RATE)]

    @property
    def return_delay(self) -> float:
        """Time that each reply waits [s]."""
        return self.get(reg.RETURN_DELAY) * model.DELAY_UNIT

    def fail(self, bits: int) -> None:
        """Notice a hardware error; where the shutdown mask has it, the torque falls to 0."""
        self.put(reg.HARDWARE_ERROR, self.get(reg.HARDWARE_ERROR) | bits)
        if bits & self.get(reg.SHUTDOWN):
            self.put(reg.TORQUE, 0)
            self._motor.stop()

    def watch(self, now: float) -> None:
        """Stop, and lock the goals, if the bus has been silent for too long at ``now`` [s]."""
        units = self.get(reg.BUS_WATCHDOG)
        if not self.get(reg.TORQUE) or units in (0, model.WATCHDOG_EXPIRED):
            return
        if now - self._heard > units * model.WATCHDOG_UNIT + 1e-9:
            self.put(reg.BUS_WATCHDOG, model.WATCHDOG_EXPIRED)
            self._motor.stop()

    def answer_damaged(self, servo: int) -> list[Reply]:
        """Return the answer to a packet for an id whose CRC is wrong."""
        if servo != self.get(reg.ID):
            return []
        return [Reply(self._encode(ErrorNumber.CRC))]

    def answer(self, packet: Packet, now: float) -> list[Reply]:
        """Return the replies to a packet that arrived by ``now`` [s]."""
        is_for_all = packet.id == codec.BROADCAST
        if not is_for_all and packet.id != self.get(reg.ID):
            return []
        self.watch(now)
        self._heard = now
        if is_for_all:
            return self._answer_all(packet, now)
        error, data = self._carry_out(packet, now)
        is_silent = self.get(reg.STATUS_RETURN_LEVEL) < _LEVEL.get(packet.instruction, 2)
        # The reply to a new id comes from the old one, which was asked; assumption
        return [] if is_silent else [Reply(self._encode(error, data, packet.id))]

    def _carry_out(self, packet: Packet, now: float) -> tuple[ErrorNumber, bytes]:
        """Carry out an instruction; return its error number and the data asked for."""
        handler = self._handlers.get(packet.instruction)
        if handler is None:
            return ErrorNumber.INSTRUCTION, b""
        try:
            return ErrorNumber.NONE, handler(packet, now)
        except RefusedError as refused:
            return refused.number, b""

    def _answer_all(self, packet: Packet, now: float) -> list[Reply]:
        """Carry out an instruction to all servos; return this one's replies.

        There is no other servo on the line: where the replies come in the order of the ids in the
        instruction, it waits for ever for those before it.
        """
        own = self.get(reg.ID)
        if packet.instruction == Instruction.PING:
            reply = self._encode(ErrorNumber.NONE, self._ping(packet, now))
            return [Reply(reply, own * PING_SLOT)]
        if packet.instruction not in codec.GROUP_INSTRUCTIONS:
            self._carry_out(packet, now)
            return []
        parts = codec.split_group(packet)
        part = next((each for each in parts if each.id == own), None)
        if part is None:
            return []
        error, data = self._carry_out(part, now)
        is_answered = part.instruction == Instruction.READ and part is parts[0]
        return [Reply(self._encode(error, data))] if is_answered else []

    def _encode(self, error: ErrorNumber, data: bytes = b"", servo: int | None = None) -> bytes:
        alert = codec.ALERT if self.get(reg.HARDWARE_ERROR) else 0
        servo = self.get(reg.ID) if servo is None else servo
        return codec.encode_status(servo, error | alert, data)

    def _ping(self, packet: Packet, now: float) -> bytes:
        return self._slice(reg.MODEL_NUMBER) + self._slice(reg.FIRMWARE_VERSION)

    def _slice(self, register: Register) -> bytes:
        return bytes(self._table[register.address : register.end])

    def _read(self, packet: Packet, now: float) -> bytes:
        if len(packet.params) != 4:
            raise RefusedError(ErrorNumber.LENGTH)
        address, length = struct.unpack("<HH", packet.params)
        if not 0 < length <= reg.SIZE - address:
            raise RefusedError(ErrorNumber.RANGE)
        self._refresh(now)
        return bytes(self._table[address : address + length])

    def _write(self, packet: Packet, now: float) -> bytes:
        values = self._check_write(packet)
        for register, value in values:
            self._store(register, value, now)
        return b""

    def _register_write(self, packet: Packet, now: float) -> bytes:
        self._check_write(packet)
        self._registered = packet.id, packet.params
        self.put(reg.REGISTERED, 1)
        return b""

    def _action(self, packet: Packet, now: float) -> bytes:
        if self._registered is None:
            raise RefusedError(ErrorNumber.FAIL)
        servo, params = self._registered
        self._registered = None
        self.put(reg.REGISTERED, 0)
        return self._write(Packet(servo, Instruction.WRITE, params), now)

    def _reboot(self, packet: Packet, now: float) -> bytes:
        eeprom = bytes(self._table[: reg.RAM])
        self._reset(now)
        self._table[: reg.RAM] = eeprom
        self.put(reg.HARDWARE_ERROR, self.profile.hardware_error if self.profile.broken else 0)
        self.deaf_until = now + BOOT
        return b""

    def _factory_reset(self, packet: Packet, now: float) -> bytes:
        kept = {KEEP_ALL: (), KEEP_ID: (reg.ID,), KEEP_ID_AND_BAUD: (reg.ID, reg.BAUD_RATE)}
        option = packet.params[0] if len(packet.params) == 1 else None
        # For all servos only what keeps their ids; assumption
        if option not in kept or (option == KEEP_ALL and packet.id == codec.BROADCAST):
            raise RefusedError(ErrorNumber.FAIL)
        before = [(register, self.get(register)) for register in kept[option]]
        self._reset(now)
        for register, value in before:
            self.put(register, value)
        self.deaf_until = now + BOOT
        return b""

    def _clear(self, packet: Packet, now: float) -> bytes:
        if packet.params != CLEAR_KEY or self.get(reg.TORQUE):
            raise RefusedError(ErrorNumber.FAIL)
        self._forget_turns(now)
        return b""

    def _forget_turns(self, now: float) -> None:
        """Know the position within one turn only, as after power-up."""
        self._forgotten += self._position(now) // model.COUNTS * model.COUNTS

    def _reset(self, now: float) -> None:
        """Set all registers to what they are as shipped, and let go."""
        self._motor.stop()
        self._registered = None
        for register in reg.REGISTERS:
            self.put(register, register.default)
        self.put(reg.MODEL_NUMBER, self.profile.model_number)
        self.put(reg.FIRMWARE_VERSION, self.profile.firmware)
        self._forget_turns(now)
        self.put(reg.GOAL_POSITION, self._position(now))

    def _check_write(self, packet: Packet) -> list[tuple[Register, int]]:
        """Return the registers that a packet writes and their values.

        Raises:
            RefusedError: It may not; nothing has been written.
        """
        if len(packet.params) < 3:
            raise RefusedError(ErrorNumber.LENGTH)
        (address,), data = struct.unpack("<H", packet.params[:2]), packet.params[2:]
        end = address + len(data)
        touched = [each for each in reg.REGISTERS if each.address < end and each.end > address]
        if not touched:
            raise RefusedError(ErrorNumber.ACCESS)
        if touched[0].address < address or touched[-1].end > end:
            raise RefusedError(ErrorNumber.LENGTH)
        values = [(each, each.find_in(data, address)) for each in touched]
        for register, value in values:
            self._check_value(register, value)
        return values

    def _check_value(self, register: Register, value: int) -> None:
        """Refuse a value that may not be written.

        Raises:
            RefusedError: It is out of range, or the register locked or read only.
        """
        if register.bounds is None or (register.address < reg.RAM and self.get(reg.TORQUE)):
            raise RefusedError(ErrorNumber.ACCESS)
        if register in reg.GOALS and self.get(reg.BUS_WATCHDOG) == model.WATCHDOG_EXPIRED:
            raise RefusedError(ErrorNumber.RANGE)
        low, high = self._limits(register) or (value, value)
        if not low <= value <= high:
            raise RefusedError(ErrorNumber.LIMIT)
        low, high = register.bounds
        if not low <= value <= high:
            raise RefusedError(ErrorNumber.RANGE)
        # After a shutdown only a reboot helps; how it refuses the torque is an assumption
        shut = self.get(reg.HARDWARE_ERROR) & self.get(reg.SHUTDOWN)
        if register == reg.TORQUE and value and shut:
            raise RefusedError(ErrorNumber.FAIL)

    def _limits(self, register: Register) -> tuple[int, int] | None:
        """Return the bounds of a goal that the limits in the EEPROM set; None if there are none."""
        if register == reg.GOAL_POSITION and self.get(reg.OPERATING_MODE) == model.POSITION_MODE:
            return self.get(reg.MIN_POSITION), self.get(reg.MAX_POSITION)
        limits = {
            reg.GOAL_PWM: reg.PWM_LIMIT,
            reg.GOAL_CURRENT: reg.CURRENT_LIMIT,
            reg.GOAL_VELOCITY: reg.VELOCITY_LIMIT,
        }
        if register not in limits:
            return None
        largest = self.get(limits[register])
        return -largest, largest

    def _store(self, register: Register, value: int, now: float) -> None:
        """Write a ``value`` and do what it asks for."""
        before = self.get(register)
        self.put(register, value)
        if register == reg.TORQUE and value != before:
            self._motor.stop()
            # It stays where it is
            self.put(reg.GOAL_POSITION, self._position(now))
        if register == reg.GOAL_POSITION and self.get(reg.TORQUE):
            self._move(now)

    def _move(self, now: float) -> None:
        """Begin to move to the goal position, in the modes that have one."""
        if self.get(reg.OPERATING_MODE) not in model.POSITION_MODES:
            return
        limit = self.get(reg.VELOCITY_LIMIT)
        speed = min(self.get(reg.PROFILE_VELOCITY) or limit, limit) * model.SPEED_UNIT
        acceleration = self.get(reg.PROFILE_ACCELERATION) * model.ACCELERATION_UNIT
        angle = self._to_angle(self.get(reg.GOAL_POSITION))
        self._motor.turn_to(angle, speed, acceleration, now)

    def _sign(self) -> int:
        return -1 if self.get(reg.DRIVE_MODE) & model.REVERSED else 1

    def _to_angle(self, position: int) -> float:
        offset = model.MIDDLE + self.get(reg.HOMING_OFFSET) - self._forgotten
        return self._sign() * (position - offset) * model.COUNT

    def _position(self, now: float) -> int:
        """Return the position at ``now`` [counts]."""
        counts = self._sign() * self._motor.angle_at(now) / model.COUNT
        return round(counts) + model.MIDDLE + self.get(reg.HOMING_OFFSET) - self._forgotten

    def _refresh(self, now: float) -> None:
        """Store what the servo measures at ``now`` [s]."""
        # Angle, speed and timer
        position = self._position(now)
        velocity = round(self._sign() * self._motor.speed_at(now) / model.SPEED_UNIT)
        milliseconds = int(now * 1000 * (1 + self.profile.skew) + 1e-6) + self.profile.tick_ms
        for register, value in (
            (reg.PRESENT_POSITION, position),
            (reg.POSITION_TRAJECTORY, position),
            (reg.PRESENT_VELOCITY, velocity),
            (reg.VELOCITY_TRAJECTORY, velocity),
            (reg.REALTIME_TICK, milliseconds % model.TICK_PERIOD),
            (reg.MOVING, int(abs(velocity) > self.get(reg.MOVING_THRESHOLD))),
            (reg.PRESENT_VOLTAGE, round(self.profile.voltage / model.VOLTAGE_UNIT)),
            (reg.PRESENT_TEMPERATURE, self.profile.temperature),
        ):
            self.put(register, value)

        # How the motion goes
        is_there = abs(position - self.get(reg.GOAL_POSITION)) <= AT_GOAL
        is_on = bool(self.get(reg.TORQUE)) and now < self._motor.profile_end
        flags = model.IN_POSITION * is_there | model.PROFILE_ON * is_on
        late = bool(self.get(reg.TORQUE)) and not is_on and not is_there
        self.put(reg.MOVING_STATUS, flags | model.NOT_FOLLOWING * late)


AT_GOAL = 10
"""Distance from the goal up to which it is in position [counts]; assumption."""
_LEVEL: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}
"""Status return level from which an instruction is answered; 2 for all others."""
