"""The XL330 as a turntable: its limits, and its positions as angles."""

from __future__ import annotations

from dataclasses import replace

from scan3d_twin.core.hal import TurntableSpec
from scan3d_twin.devices.dynamixel import model

SPEC = TurntableSpec(
    name="xl330",
    min_angle=-model.CABLE_LIMIT,
    max_angle=model.CABLE_LIMIT,
    max_speed=model.VELOCITY_LIMIT * model.SPEED_UNIT,
    resolution=model.COUNT,
    sample_period=model.sample_period(1_000_000),
    play=model.PLAY,
)
"""The turntable as shipped, but at 1000000 baud."""


def limit_spec(positions: tuple[int, int], max_velocity: int, baud: int) -> TurntableSpec:
    """Return the spec of one servo.

    Args:
        positions: Its smallest and largest position [counts].
        max_velocity: Its velocity limit [0.229 rev/min].
        baud: Its bit rate [bit/s].
    """
    low, high = positions
    return replace(
        SPEC,
        min_angle=to_angle(low),
        max_angle=to_angle(high),
        max_speed=max_velocity * model.SPEED_UNIT,
        sample_period=model.sample_period(baud),
    )


def to_angle(position: int) -> float:
    """Return the angle of a ``position`` [counts] from the middle [rad]."""
    return (position - model.MIDDLE) * model.COUNT
