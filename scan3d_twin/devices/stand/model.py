"""Dimensions of a stand with a round foot; named assumptions, of a microphone stand."""

from __future__ import annotations

from scan3d_twin.core.hal import BaseSpec

STAND = BaseSpec(
    name="stand",
    radius=0.125,
    wheel_base=0.25,  # has none: the width of its foot
    wheel_diameter=0.25,  # has none either
    counts_per_turn=1.0,
    max_wheel_speed=0.0,
    sample_period=0.02,
)
