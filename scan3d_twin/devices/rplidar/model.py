"""Constants of the RPLIDAR A1, C1 and S2, shared by twin, driver and emulator.

Sources: data sheets of the A1M8 (LD108), C1M1 (rev. 1.1) and S2M1; Slamtec's SDK 2.1.0; reports of
users by repository and number. A value that no source gives is called an assumption.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from scan3d_twin.core.types import FloatArray
from scan3d_twin.devices.rplidar.capsules import CAPSULE_LENGTH, DENSE_SAMPLES, EXPRESS_SAMPLES
from scan3d_twin.devices.rplidar.codec import ReplyType
from scan3d_twin.devices.rplidar.nodes import NODE_LENGTH

MIN_CONF_FIRMWARE = (1, 24)
"""First firmware of an A1 that answers GET_LIDAR_CONF; the SDK."""
MIN_CONF_SERIES = 4
"""First series that answers it with every firmware; the SDK."""
STOP_PAUSE = 0.001
"""Time after STOP in which the lidar takes no request [s]; the protocol's manual."""
NO_RETURN = 0
"""Code of a reading without a distance; the lidar sends a distance of 0 for every cause."""
SAMPLES = {ReplyType.NODES: 1, ReplyType.EXPRESS: EXPRESS_SAMPLES, ReplyType.DENSE: DENSE_SAMPLES}
"""Samples in a frame, by the type of the reply."""
FRAME_LENGTHS = {
    ReplyType.NODES: NODE_LENGTH,
    ReplyType.EXPRESS: CAPSULE_LENGTH,
    ReplyType.DENSE: CAPSULE_LENGTH,
}
"""Length of a frame [bytes], by the type of the reply."""


class Motor(Enum):
    """How the motor is started and stopped.

    An A1 turns while the line DTR is not set: the SDK, pyrplidar#10. An S2 is told its speed in
    revolutions per minute. A C1 turns while it scans; assumption, from the data sheet of the S1,
    whose motor "can't start and stop alone, its working state depends on the laser scan operation".
    """

    DTR = "dtr"
    SPEED = "speed"
    SCAN = "scan"


@dataclass(frozen=True, slots=True)
class RangeNoise:
    """Noise of the readings.

    Attributes:
        constant: Its standard deviation at no distance [m].
        per_metre: What it grows by with each metre [m].
    """

    constant: float
    per_metre: float

    def at(self, ranges: FloatArray) -> FloatArray:
        """Return the standard deviations at ``ranges`` (n,) [m]."""
        return self.constant + self.per_metre * ranges


@dataclass(frozen=True, slots=True)
class ScanMode:
    """One way to scan.

    Attributes:
        name: As GET_LIDAR_CONF states it.
        number: Its number in requests; 0 is the standard scan.
        reply: Frames in which it sends its samples.
        sample_us: Time per sample [us].
        reach_m: Longest distance that it states [m].
    """

    name: str
    number: int
    reply: ReplyType
    sample_us: float
    reach_m: float

    @property
    def sample_rate(self) -> float:
        """Samples per second [Hz]."""
        return 1e6 / self.sample_us


@dataclass(frozen=True, slots=True)
class RplidarModel:
    """One RPLIDAR.

    Attributes:
        name: Name by which it is chosen.
        title: Its name in messages.
        model: Model byte of GET_INFO.
        firmware: Major and minor version of the emulated one.
        hardware: Hardware revision of the emulated one.
        baud: Bit rate [bit/s]; fixed.
        modes: Scan modes by the name of the link, the preferred one first.
        turns: Turns per second at which it is run.
        slowest_turns: Slowest turns per second for which the grid of a line has room.
        motor: How the motor is controlled.
        min_range_mm: Shortest distance [mm].
        max_range_mm: Longest distance to a white surface [mm].
        noise: Noise of its readings.
        spin_up: Time from a standstill until the rotation is stable and data come [s].
        boot: Time after RESET in which it does not listen [s].
        boot_text: What it sends when it has booted.
    """

    name: str
    title: str
    model: int
    firmware: tuple[int, int]
    hardware: int
    baud: int
    modes: Mapping[str, ScanMode]
    turns: float
    slowest_turns: float
    motor: Motor
    min_range_mm: int
    max_range_mm: int
    noise: RangeNoise
    spin_up: float
    boot: float
    boot_text: bytes = b""

    @property
    def major_id(self) -> int:
        """Series: the high nibble of the model byte."""
        return self.model >> 4

    @property
    def has_conf(self) -> bool:
        """Whether the emulated one answers GET_LIDAR_CONF."""
        return answers_conf(self.model, self.firmware)

    @property
    def rpm(self) -> int:
        """Speed of the motor [1/min]."""
        return round(60 * self.turns)


def answers_conf(model: int, firmware: tuple[int, int]) -> bool:
    """Return whether a lidar of this model byte and firmware answers GET_LIDAR_CONF."""
    return model >> 4 >= MIN_CONF_SERIES or firmware >= MIN_CONF_FIRMWARE


STANDARD, EXPRESS, DENSE = "standard", "express", "dense"
"""Names of the links: what is sent over the line."""

# The +-30 mm of the data sheets, read as three standard deviations of the sum of noise, unit and
# surface; how it is shared: assumption.
TOF_NOISE = RangeNoise(0.008, 0.0)

A1 = RplidarModel(
    name="rplidar_a1",
    title="RPLIDAR A1",
    # The boot text of an A1 says "Model 18".
    model=0x18,
    firmware=(1, 29),
    hardware=7,
    baud=115200,
    # 508 and 254 us: mikkleini/rplidar.net#2. Boost and what else newer firmwares have is left out.
    modes={
        EXPRESS: ScanMode("Express", 1, ReplyType.EXPRESS, 254.0, 12.0),
        STANDARD: ScanMode("Standard", 0, ReplyType.NODES, 508.0, 12.0),
    },
    # With the motor's pin at full speed, as on the USB adapter: 267 samples of 508 us a turn
    # (donkeycar#914); the data sheet has 5.5 typically and 10 at most.
    turns=7.4,
    slowest_turns=7.15,
    motor=Motor.DTR,
    min_range_mm=150,
    max_range_mm=12000,
    # One A1M8 on a flat board 1181 mm away: 2.0 mm (donkeycar#914); in proportion to the distance
    # also the .2 % at 6 m of the data sheet's figure 2-2.
    noise=RangeNoise(0.0, 0.0017),
    # Assumption: 1 to 2 s.
    spin_up=1.5,
    # rplidar_sdk#36, ardupilot#9981: 2 ms are too short, 20 ms about enough, 1 s safe.
    boot=0.5,
    boot_text=b"RP LIDAR System.\r\nFirmware Ver 1.29, HW Ver 7\r\nModel: 18\r\n",
)
C1 = RplidarModel(
    name="rplidar_c1",
    title="RPLIDAR C1",
    model=0x41,
    firmware=(1, 1),
    hardware=18,
    baud=460800,
    # 5 kHz: data sheet; 16 m: rplidar_driver#1; that 1 is the dense mode: assumption, as on an S2.
    modes={
        DENSE: ScanMode("DenseBoost", 1, ReplyType.DENSE, 200.0, 16.0),
        STANDARD: ScanMode("Standard", 0, ReplyType.NODES, 200.0, 16.0),
    },
    turns=10.0,
    slowest_turns=9.8,
    motor=Motor.SCAN,
    min_range_mm=50,
    max_range_mm=12000,
    noise=TOF_NOISE,
    # Assumption.
    spin_up=1.5,
    # Assumption, as an S1: deaf for 2 s and without a text (ardupilot#14527).
    boot=2.0,
)
S2 = RplidarModel(
    name="rplidar_s2",
    title="RPLIDAR S2",
    model=0x71,
    firmware=(1, 1),
    hardware=18,
    baud=1_000_000,
    # 32 kHz: data sheet; the number of the mode: assumption, as that of the S3 (rplidar_ros#155);
    # the 10 kHz of the standard scan: assumption.
    modes={
        DENSE: ScanMode("DenseBoost", 1, ReplyType.DENSE, 31.25, 30.0),
        STANDARD: ScanMode("Standard", 0, ReplyType.NODES, 100.0, 30.0),
    },
    turns=10.0,
    slowest_turns=9.8,
    motor=Motor.SPEED,
    # Both nearest and farthest: assumptions, from kaiaai/awesome-2d-lidars.
    min_range_mm=50,
    max_range_mm=30000,
    noise=TOF_NOISE,
    # Assumption: 2 to 3 s. A scan asked for within a second of the start fails (rplidar_ros#73).
    spin_up=2.0,
    boot=2.0,
)
MODELS = {each.major_id: each for each in (C1, A1, S2)}
"""The models by series, the most likely first."""
