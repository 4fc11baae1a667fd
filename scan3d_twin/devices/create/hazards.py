"""From the raw sensor packets of a Create to ``Hazards``, and which of them stop the robot."""

from __future__ import annotations

from scan3d_twin.core.errors import HazardError
from scan3d_twin.core.types import Hazards
from scan3d_twin.devices.create.link import Values
from scan3d_twin.devices.create.packets import BumpsDrops, Overcurrents, Packet

EMPTY_MV, FULL_MV = 12_600, 15_600
"""Voltages taken for 0 and 1 where the base reports no charge [mV]; 12 NiMH cells."""
LOW_BATTERY = 0.1
"""State of charge below which the robot does not drive, 0..1; it must still find home."""


def decode_hazards(values: Values) -> Hazards:
    """Return the hazards in the readings of ``COMMON``."""
    bumps, over = BumpsDrops(values[Packet.BUMPS_DROPS]), values[Packet.OVERCURRENTS]
    caster = bool(bumps & BumpsDrops.DROP_CASTER)

    return Hazards(
        bump_left=bool(bumps & BumpsDrops.BUMP_LEFT),
        bump_right=bool(bumps & BumpsDrops.BUMP_RIGHT),
        cliff_left=bool(values[Packet.CLIFF_LEFT]),
        cliff_front_left=bool(values[Packet.CLIFF_FRONT_LEFT]),
        cliff_front_right=bool(values[Packet.CLIFF_FRONT_RIGHT]),
        cliff_right=bool(values[Packet.CLIFF_RIGHT]),
        wheel_drop_left=caster or bool(bumps & BumpsDrops.DROP_LEFT),
        wheel_drop_right=caster or bool(bumps & BumpsDrops.DROP_RIGHT),
        overcurrent_left=bool(over & Overcurrents.LEFT_WHEEL),
        overcurrent_right=bool(over & Overcurrents.RIGHT_WHEEL),
        battery=_battery(values),
    )


def _battery(values: Values) -> float:
    """Return the state of charge, 0..1; from the voltage if the base reports no capacity."""
    if capacity := values[Packet.CAPACITY]:
        return min(1.0, values[Packet.CHARGE] / capacity)
    return min(1.0, max(0.0, (values[Packet.VOLTAGE] - EMPTY_MV) / (FULL_MV - EMPTY_MV)))


def check_ready(hazards: Hazards, *, charging: bool) -> None:
    """Raise ``HazardError`` if a base must not start driving."""
    if charging:
        raise HazardError("the base is on its charger: unplug it or take it off the dock")
    if hazards.battery < LOW_BATTERY:
        raise HazardError(f"low battery: {hazards.battery:.0%} left; charge the base")


def blocking_hazards(before: Hazards, now: Hazards, ahead: int) -> tuple[str, ...]:
    """Return the hazards to stop for: new ones, and all active ones if driving forwards.

    Args:
        before: Hazards at the time of the previous readings.
        now: Current hazards.
        ahead: Positive if the robot drives forwards; its unit does not matter.
    """
    active = now.active()
    return active if ahead > 0 else tuple(n for n in active if n not in before.active())


def find_unsafe_causes(values: Values, hazards: Hazards) -> list[str]:
    """Return the causes for which the base may have left Safe mode while driving."""
    if values[Packet.CHARGING_SOURCES]:
        return ["the charger was plugged in"]
    return list(hazards.active()) or [
        "the base left Safe mode (the guard stopped it after 0.3 s without a sign of life, or it "
        "lost its footing for a moment)"
    ]
