"""Numbers of the Dynamixel XL330-M288 and XL330-M077, shared by driver and emulator.

Sources, named in brackets:

- [manual] Robotis e-manual of the XL330-M288-T and XL330-M077-T, with its control table;
- [SDK] dynamixel-sdk 4.1.0, the maker's package, and the control tables ``*.model`` in it;
- [issue] the report that is named;
- [assumption] of this project: no source states it.

No figure here was measured on a device.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from scan3d_twin.devices.links.line_format import BITS_PER_BYTE

COUNTS = 4096
"""Counts of the angle sensor in a turn [manual]."""
COUNT = math.tau / COUNTS
"""Step of position and goal, 0.088 deg [rad] [manual]."""
MIDDLE = 2048
"""Position of the middle, the angle 0 [counts] [manual]."""
SPEED_UNIT = 0.229 * math.tau / 60
"""Unit of speeds, 0.229 rev/min [rad/s] [manual]."""
ACCELERATION_UNIT = 214.577 * math.tau / 3600
"""Unit of the profile's acceleration, 214.577 rev/min^2 [rad/s^2] [manual]."""
DELAY_UNIT = 2e-6
"""Unit of the return delay [s] [manual]."""
WATCHDOG_UNIT = 0.02
"""Unit of the bus watchdog [s] [manual]."""
WATCHDOG_EXPIRED = 0xFF
"""Content of the bus watchdog when it has expired: -1 [manual]."""
TICK, TICK_PERIOD = 1e-3, 32768
"""Step of its timer [s], and the number of steps after which it is 0 again [manual]."""
BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""Bit rates by the number in the register ``baud rate`` [manual]."""
FACTORY_BAUD, FACTORY_ID = 57600, 1
"""Bit rate and id as shipped [manual]."""
VOLTAGE_UNIT = 0.1
"""Unit of the supply voltage [V] [manual]."""
SUPPLY = 3.7, 6.0
"""Supply voltage that it stands [V] [manual]."""

POSITION_MODE, MULTI_TURN_MODE, CURRENT_POSITION_MODE = 3, 4, 5
POSITION_MODES = (POSITION_MODE, MULTI_TURN_MODE, CURRENT_POSITION_MODE)
"""Operating modes that move to a goal position [manual]."""
REVERSED, TIME_BASED = 0b001, 0b100
"""Bits of the drive mode: position grows clockwise; profiles state times, not speeds [manual]."""
IN_POSITION, PROFILE_ON, NOT_FOLLOWING = 0b0001, 0b0010, 0b1000
"""Bits of the moving status [manual]."""

HARDWARE_ERRORS: Mapping[int, tuple[str, str]] = {
    0: ("its supply voltage is out of range", "give it 5 V from a supply of 1.5 A"),
    2: ("it is too hot", "let it cool down, lighten its load"),
    3: ("its encoder does not work", "replace it"),
    4: ("its motor circuit has failed or lacks power", "check its supply and its cable"),
    5: ("it was overloaded", "free what it turns, lighten its load"),
}
"""What the bits of the register ``hardware error`` mean [manual], and the cure [assumption]."""
VOLTAGE_ERROR, HEAT_ERROR, OVERLOAD_ERROR = 1 << 0, 1 << 2, 1 << 5


M288 = 1200
MODELS = {M288: "XL330-M288", 1190: "XL330-M077"}
"""Models by the number in register 0: gears of 288.4:1, and faster ones [manual]."""
VELOCITY_LIMIT = 445
"""Velocity limit of an M288 as shipped [0.229 rev/min] [manual]; no load allows 103 rev/min."""
FIRMWARE = 52
"""Version of the emulated firmware; one with a control table of its own in [SDK]."""

SERVICE_INTERVAL = 0.005
"""Interval at which the robot's clock services its drivers [s]; a reading takes at least one."""
POLLED_BYTES = 65
"""Bytes on the line for one reading of its state at most: 14 to ask, 51 to answer."""
ACCELERATION = 2.0
"""Acceleration of the motions [rad/s^2], so that a lidar of some 200 g does not shake
[assumption]; 0 in the register is a step to full speed, which jerks [manual]."""
PLAY = math.radians(1.0)
"""Play between the angle sensor and the horn [rad]: none found for it; a Feetech STS3215, of its
class, has about 1 deg, and more under load [issue SO-ARM100#134]."""
CABLE_LIMIT = math.radians(200.0)
"""Largest turn to either side [rad]: a full turn and the run-ups of a sweep, and no more of the
lidar's cable [assumption]; kept by the driver, as a servo for several turns knows no limits."""
WATCHDOG = 0.3
"""Silence after which a moving servo stops by itself [s]: as the guard of a base; fifteen times
the slowest reading."""


def sample_period(baud: int) -> float:
    """Return the time between two samples at a bit rate, with an order between them [s]."""
    transfer = POLLED_BYTES * BITS_PER_BYTE / baud
    return SERVICE_INTERVAL * (1 + math.ceil(transfer / SERVICE_INTERVAL))
