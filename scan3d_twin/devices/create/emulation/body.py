"""The body of an emulated Create: its wheel encoders and sensors.

Wheels, hazards and battery come from the drive base behind the hardware interface; charger,
buttons, walls and cargo bay inputs are attributes that the user of the emulator may set.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scan3d_twin.core.hal import DriveBase
from scan3d_twin.core.types import Odometry
from scan3d_twin.devices.create.codec import Model
from scan3d_twin.devices.create.packets import BumpsDrops, Overcurrents, Packet

CAPACITY_MAH = 2696
"""Battery capacity [mAh]; as read on a Create 2, assumption for the Create 1."""
EMPTY_MV, FULL_MV = 12_600, 16_000
"""Voltage of 12 NiMH cells when empty and when full [mV]; assumption."""
FLOOR_SIGNAL, CLIFF_SIGNAL = 1500, 20
"""Cliff signals over the floor and over a drop, 0..4095; assumption."""


@dataclass(frozen=True, slots=True)
class Quirks:
    """Deviations of real firmware from its manual or from other versions.

    Attributes:
        header_summed: Whether the stream's checksum covers the header. The Create manual says no,
            the Create 2 manual and drivers that run on real Creates say yes.
        mode_offset: Added to the reported mode; 1 on some Roomba 600 (create_robot issue 64).
        truncates: Whether each read of packets 19 and 20 drops the fraction (libcreate issue 22).
        angle_gain: Scale of packet 20; 0.25 on firmware 2012-03-22 (robotics.stackexchange 7121).
        distance_unsigned: Whether packet 19 grows in reverse too (answers.ros.org 12338).
        deaf: Time after a mode change during which received bytes are lost [s]; 0.02 in Hacking
            Roomba, page 26.
        counts: Encoder counts (left, right) at power-on.
        silent: Whether it stays silent until its battery is taken out (create_robot issue 54).
        steps_speed: Whether the wheels drive a few speeds only (``roomba.step_speed``).
    """

    header_summed: bool = True
    mode_offset: int = 0
    truncates: bool = True
    angle_gain: float = 1.0
    distance_unsigned: bool = False
    deaf: float = 0.0
    counts: tuple[int, int] = (0, 0)
    silent: bool = False
    steps_speed: bool = False


class Wheels:
    """Encoder counts, and the motion since packets 19 and 20 were last read.

    Attributes:
        distance_mm: Distance since packet 19 was last read [mm].
        angle_deg: Rotation since packet 20 was last read [deg].
        total_mm: Distance since power-on [mm].
        total_deg: Rotation since power-on [deg].
    """

    def __init__(self, model: Model, quirks: Quirks, start: Odometry) -> None:
        self.distance_mm = self.angle_deg = 0.0
        self.total_mm = self.total_deg = 0.0
        self._left_mm = self._right_mm = 0.0
        self._model = model
        self._quirks = quirks
        self._last = start

    def take(self, odometry: Odometry) -> None:
        """Add the motion from the previous sample to ``odometry``, taken as an arc."""
        # Arc between the two samples
        step = self._last.T_odom_base.inverse() @ odometry.T_odom_base
        self._last = odometry
        half = step.yaw / 2
        chord = step.x * math.cos(half) + step.y * math.sin(half)
        way = 1000 * chord * (half / math.sin(half) if abs(half) > 1e-9 else 1.0)
        side = step.yaw * self._model.wheel_base_mm / 2

        # Wheels, totals and packets
        self._left_mm += way - side
        self._right_mm += way + side
        self.total_mm += way
        self.total_deg += math.degrees(step.yaw)
        self.distance_mm += abs(way) if self._quirks.distance_unsigned else way
        self.angle_deg += math.degrees(step.yaw) * self._quirks.angle_gain

    def counts(self) -> tuple[int, int]:
        """Return the encoder counts (left, right), 0..65535; 0 on a Create 1, which has none."""
        if not self._model.has_counts:
            return 0, 0
        per_mm, (left, right) = 1 / self._model.mm_per_count, self._quirks.counts
        return (
            (left + round(self._left_mm * per_mm)) & 0xFFFF,
            (right + round(self._right_mm * per_mm)) & 0xFFFF,
        )

    def read_distance(self) -> int:
        """Return packet 19 [mm] and reset it."""
        value = int(self.distance_mm)
        self.distance_mm = 0.0 if self._quirks.truncates else self.distance_mm - value
        return value

    def read_angle(self) -> int:
        """Return packet 20 [deg] and reset it."""
        value = int(self.angle_deg)
        self.angle_deg = 0.0 if self._quirks.truncates else self.angle_deg - value
        return value


class Body:
    """All sensors the firmware can read.

    Attributes:
        charger: Bits of packet 34.
        buttons: Bits of packet 18.
        virtual_wall: Whether a virtual wall is seen, packet 13.
        inputs: Bits of packet 32, the cargo bay's digital inputs.
        analog: Packet 33, the cargo bay's analog input, 0..1023.
        ir: Characters that the omnidirectional, left and right receiver see, packets 17, 52 and 53,
            such as ``DockSignal``; None is no character.
    """

    def __init__(self, base: DriveBase, model: Model, quirks: Quirks) -> None:
        self.charger = self.buttons = self.inputs = self.analog = 0
        self.virtual_wall = False
        self.ir: tuple[int | None, int | None, int | None] = (None, None, None)
        self.wheels = Wheels(model, quirks, base.odometry())
        self._base = base
        self._no_ir = 0 if model.has_counts else 255

    def cliff(self) -> bool:
        """Return whether any of the four cliff sensors sees no floor."""
        return any(self._cliffs())

    def dropped(self) -> bool:
        """Return whether a wheel hangs in the air."""
        hazards = self._base.hazards()
        return hazards.wheel_drop_left or hazards.wheel_drop_right

    def bumps(self) -> BumpsDrops:
        """Return packet 7: bumpers and wheel drops."""
        hazards = self._base.hazards()
        bits = BumpsDrops(0)
        bits |= BumpsDrops.BUMP_RIGHT if hazards.bump_right else 0
        bits |= BumpsDrops.BUMP_LEFT if hazards.bump_left else 0
        bits |= BumpsDrops.DROP_RIGHT if hazards.wheel_drop_right else 0
        return bits | (BumpsDrops.DROP_LEFT if hazards.wheel_drop_left else 0)

    def readings(self) -> dict[int, int]:
        """Return the readings by packet, except 19 and 20, which reading would reset."""
        return {**self._safety_readings(), **self._power_readings(), **self._other_readings()}

    def _cliffs(self) -> tuple[bool, bool, bool, bool]:
        h = self._base.hazards()
        return h.cliff_left, h.cliff_front_left, h.cliff_front_right, h.cliff_right

    def _safety_readings(self) -> dict[int, int]:
        hazards, cliffs = self._base.hazards(), self._cliffs()
        overcurrents = Overcurrents.RIGHT_WHEEL if hazards.overcurrent_right else 0
        overcurrents |= Overcurrents.LEFT_WHEEL if hazards.overcurrent_left else 0
        signals = (CLIFF_SIGNAL if cliff else FLOOR_SIGNAL for cliff in cliffs)
        return {
            Packet.BUMPS_DROPS: self.bumps(),
            **dict(zip(range(Packet.CLIFF_LEFT, Packet.VIRTUAL_WALL), cliffs, strict=True)),
            **dict(zip(range(Packet.CLIFF_LEFT_SIGNAL, 32), signals, strict=True)),
            Packet.VIRTUAL_WALL: self.virtual_wall,
            Packet.OVERCURRENTS: overcurrents,
        }

    def _power_readings(self) -> dict[int, int]:
        share = self._base.hazards().battery
        return {
            Packet.CHARGING_STATE: 2 if self.charger else 0,
            Packet.VOLTAGE: round(EMPTY_MV + share * (FULL_MV - EMPTY_MV)),
            Packet.CURRENT: 1000 if self.charger else -300,
            Packet.TEMPERATURE: 25,
            Packet.CHARGE: round(share * CAPACITY_MAH),
            Packet.CAPACITY: CAPACITY_MAH,
            Packet.CHARGING_SOURCES: self.charger,
        }

    def _other_readings(self) -> dict[int, int]:
        left, right = self.wheels.counts()
        omni, ir_left, ir_right = (self._no_ir if seen is None else seen for seen in self.ir)
        return {
            Packet.IR_OMNI: omni,
            Packet.IR_LEFT: ir_left,
            Packet.IR_RIGHT: ir_right,
            Packet.BUTTONS: self.buttons,
            Packet.DIGITAL_INPUTS: self.inputs,
            Packet.ANALOG_INPUT: self.analog,
            Packet.LEFT_COUNTS: left,
            Packet.RIGHT_COUNTS: right,
        }
