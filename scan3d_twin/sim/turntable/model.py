"""The turntables of the twin by name, with their limits and errors.

Importing this module costs nothing (no numpy): ``twin --help`` lists the names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from scan3d_twin.core.errors import UnknownNameError

CABLE_LIMIT = math.radians(200.0)
"""Largest turn to either side [rad]: a full turn and the run-ups of a sweep, and no more of the
lidar's cable; an assumption. An XL330 in multi-turn mode has no limit of its own."""


@dataclass(frozen=True, slots=True)
class TurntableModel:
    """A turntable as the twin simulates it.

    It turns by a trapezoid of its speed. The torque that turns a lidar of 0.16 kg at 2 rad/s2 is
    below 1 mN m and moves no base.

    Attributes:
        name: By which it is chosen.
        max_speed: [rad/s].
        speed_step: Step of the speeds it can be told [rad/s].
        acceleration: Of its profile [rad/s2].
        resolution: Step of its angles [rad].
        noise: Noise of its angle sensor, standard deviation [rad].
        sample_period: Time between two samples of its angle [s].
        clock_offset: Delay of the stamps of these samples [s].
        clock_step: Resolution of these stamps [s].
        play: Nominal play between its angle sensor and the lidar [rad].
        play_spread: Standard deviation of the play among units, as a share of it.
    """

    name: str
    max_speed: float
    speed_step: float
    acceleration: float
    resolution: float
    noise: float
    sample_period: float
    clock_offset: float
    clock_step: float
    play: float
    play_spread: float


IDEAL = TurntableModel(
    name="ideal",
    max_speed=10.0,
    speed_step=1e-6,
    acceleration=10.0,
    resolution=1e-6,
    noise=0.0,
    sample_period=0.01,
    clock_offset=0.0,
    clock_step=0.0,
    play=0.0,
    play_spread=0.0,
)
"""A turntable without errors, for tests."""

XL330 = TurntableModel(
    name="xl330",
    max_speed=103 * math.tau / 60,  # manual: 103 rev/min at 5 V
    speed_step=0.229 * math.tau / 60,  # manual: profile velocity in 0.229 rev/min
    acceleration=2.0,  # profile acceleration that a driver chooses; an assumption
    resolution=math.tau / 4096,  # manual: 12 bit absolute
    noise=0.3 * math.tau / 4096,  # a third of a count; an assumption
    sample_period=0.02,  # 50 Hz, as one servo can be polled at 57600 baud
    clock_offset=0.001,  # USB latency timer set to 1 ms
    clock_step=0.001,  # manual: its tick counts milliseconds
    play=math.radians(1.0),  # none found for it; a servo of its class (STS3215): about 1 deg
    play_spread=0.1,  # units of a batch differ by this; an assumption
)
"""Dynamixel XL330-M288."""

TURNTABLES = {model.name: model for model in (IDEAL, XL330)}
DEFAULT_TURNTABLE = XL330.name


def find_turntable(name: str) -> TurntableModel:
    """Return the turntable called ``name``.

    Raises:
        UnknownNameError: There is none.
    """
    if name not in TURNTABLES:
        raise UnknownNameError("turntable", name, TURNTABLES)
    return TURNTABLES[name]
