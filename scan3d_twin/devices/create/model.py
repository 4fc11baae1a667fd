"""Data sheets of the iRobot Create 1 and Create 2, in SI units.

Sources: AutonomyLab create_robot URDF; AutonomyLab libcreate, types.cpp; iRobot Create 2 Open
Interface based on the Roomba 600 (2016).
"""

from __future__ import annotations

import math
from dataclasses import replace

from scan3d_twin.core.hal import BaseSpec

CREATE2 = BaseSpec(
    name="create2",
    radius=0.165,  # create_robot URDF
    wheel_base=0.235,  # libcreate types.cpp, as the next two
    wheel_diameter=0.072,
    counts_per_turn=508.8,
    max_wheel_speed=0.5,  # Create 2 Open Interface: +-500 mm/s
    sample_period=0.015,  # Create 2 Open Interface: sensors are updated every 15 ms
)
CREATE1 = replace(
    CREATE2,
    name="create1",
    wheel_base=0.258,  # libcreate types.cpp, as the next
    wheel_diameter=0.078,
    counts_per_turn=1000 * math.pi * 0.078,  # no encoders: packet 19 counts whole millimetres
)
