"""Control table of the XL330: the registers by which a program reads and commands it.

Addresses, sizes and defaults are those of the manual named in ``model``; where the manual states
no bounds, the bounds are those of the size. The indirect registers, 168 to 227, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

RAM = 64
"""First address of the RAM; below it is the EEPROM, locked while the torque is on."""


@dataclass(frozen=True, slots=True)
class Register:
    """One register.

    Attributes:
        address: Address of its first byte.
        size: Number of bytes, low byte first.
        default: Content as shipped, or at power-up.
        bounds: Smallest and largest value that may be written; None is read only.
        is_signed: Whether its values may be negative.
    """

    address: int
    size: int
    default: int = 0
    bounds: tuple[int, int] | None = None
    is_signed: bool = False

    @property
    def end(self) -> int:
        """Address behind its last byte."""
        return self.address + self.size

    def decode(self, data: bytes | bytearray) -> int:
        """Return the value of its bytes."""
        return int.from_bytes(data, "little", signed=self.is_signed)

    def encode(self, value: int) -> bytes:
        """Return the bytes of a value."""
        return (value % (1 << 8 * self.size)).to_bytes(self.size, "little")

    def find_in(self, block: bytes, start: int) -> int:
        """Return its value in a ``block`` of the table that begins at address ``start``."""
        at = self.address - start
        return self.decode(block[at : at + self.size])


MODEL_NUMBER = Register(0, 2)
MODEL_INFORMATION = Register(2, 4)
FIRMWARE_VERSION = Register(6, 1)
ID = Register(7, 1, 1, (0, 252))
BAUD_RATE = Register(8, 1, 1, (0, 6))
RETURN_DELAY = Register(9, 1, 250, (0, 254))
DRIVE_MODE = Register(10, 1, 0, (0, 13))
OPERATING_MODE = Register(11, 1, 3, (0, 16))
SECONDARY_ID = Register(12, 1, 255, (0, 255))
PROTOCOL_TYPE = Register(13, 1, 2, (2, 22))
HOMING_OFFSET = Register(20, 4, 0, (-1_044_479, 1_044_479), True)
MOVING_THRESHOLD = Register(24, 4, 10, (0, 1023))
TEMPERATURE_LIMIT = Register(31, 1, 70, (0, 100))
MAX_VOLTAGE = Register(32, 2, 70, (31, 70))
MIN_VOLTAGE = Register(34, 2, 35, (31, 70))
PWM_LIMIT = Register(36, 2, 885, (0, 885))
CURRENT_LIMIT = Register(38, 2, 1750, (0, 1750))
VELOCITY_LIMIT = Register(44, 4, 445, (0, 2047))
MAX_POSITION = Register(48, 4, 4095, (0, 4095))
MIN_POSITION = Register(52, 4, 0, (0, 4095))
PWM_SLOPE = Register(62, 1, 140, (1, 255))
SHUTDOWN = Register(63, 1, 53, (0, 63))
TORQUE = Register(64, 1, 0, (0, 1))
LED = Register(65, 1, 0, (0, 1))
STATUS_RETURN_LEVEL = Register(68, 1, 2, (0, 2))
REGISTERED = Register(69, 1)
HARDWARE_ERROR = Register(70, 1)
VELOCITY_I = Register(76, 2, 1600, (0, 16383))
VELOCITY_P = Register(78, 2, 180, (0, 16383))
POSITION_D = Register(80, 2, 0, (0, 16383))
POSITION_I = Register(82, 2, 0, (0, 16383))
POSITION_P = Register(84, 2, 400, (0, 16383))
FEEDFORWARD_2 = Register(88, 2, 0, (0, 16383))
FEEDFORWARD_1 = Register(90, 2, 0, (0, 16383))
BUS_WATCHDOG = Register(98, 1, 0, (0, 127))
GOAL_PWM = Register(100, 2, 885, (-885, 885), True)
GOAL_CURRENT = Register(102, 2, 1750, (-1750, 1750), True)
GOAL_VELOCITY = Register(104, 4, 0, (-2047, 2047), True)
PROFILE_ACCELERATION = Register(108, 4, 0, (0, 32767))
PROFILE_VELOCITY = Register(112, 4, 0, (0, 32767))
GOAL_POSITION = Register(116, 4, 0, (-1_048_575, 1_048_575), True)
REALTIME_TICK = Register(120, 2)
MOVING = Register(122, 1)
MOVING_STATUS = Register(123, 1)
PRESENT_PWM = Register(124, 2, is_signed=True)
PRESENT_CURRENT = Register(126, 2, is_signed=True)
PRESENT_VELOCITY = Register(128, 4, is_signed=True)
PRESENT_POSITION = Register(132, 4, is_signed=True)
VELOCITY_TRAJECTORY = Register(136, 4, is_signed=True)
POSITION_TRAJECTORY = Register(140, 4, is_signed=True)
PRESENT_VOLTAGE = Register(144, 2)
PRESENT_TEMPERATURE = Register(146, 1)
BACKUP_READY = Register(147, 1)

REGISTERS = tuple(each for each in list(globals().values()) if isinstance(each, Register))
"""All of them, by address."""
SIZE = max(each.end for each in REGISTERS)
"""Number of bytes of the table that is modelled."""
GOALS = (GOAL_PWM, GOAL_CURRENT, GOAL_VELOCITY, GOAL_POSITION)
"""Registers that are locked while the bus watchdog has expired."""
