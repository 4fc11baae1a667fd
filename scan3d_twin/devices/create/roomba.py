"""The Roomba 500 to 800: what differs from the Create 2, which is a Roomba 600 without its brushes.

Sources: [500] the constants of three drivers that were written for a Roomba 500 and its manual
(ROS ``roomba_500_series``, Fawkes ``roomba_500.h``, ``mirkosertic/roomba500``); [600] iRobot
Create 2 Open Interface based on the Roomba 600 (2016); [lib] the table of ``create_robot``, which
drives the 700 and 800 as a Create 2, verified by their owners; [W] Wikipedia, "Roomba".

* Packets 43 and 44 are the counts of the left and the right wheel on all of them. The names in the
  first two drivers of [500] are the other way round; one divides the turn by minus the wheel base
  for it, and the third, like [600], has the left wheel first.
* One count is 0.4456 mm in [500] and 0.4446 mm in [600]; a Roomba 500 calibrated by its owner has
  0.4429 mm. That is 0.6 % at most, less than two robots of one series differ by.
* A Roomba 780 whose odometry turned by "a bit less than 1.125" in one turn (create_robot issue 32)
  was read with wheels of 78 mm, which libcreate has since corrected to 72 mm (its issue 35): 4 %
  remain.
"""

from __future__ import annotations

import math
from dataclasses import replace

from scan3d_twin.devices.create.codec import CREATE2, MAX_WHEEL_SPEED_MM, Op

FIRST_STEP_MM, STEP_MM = 11.0, 28.5
"""Slowest wheel speed that moves one Create 2, and the width of a step of speed [mm/s];
ktibow.github.io/blog/roombamotors. Nobody has reported the steps of another one, nor of a Roomba;
that a Roomba does not drive under 10 mm/s is on page 15 of Hacking Roomba, too."""

ROOMBA600 = replace(CREATE2, name="roomba600", min_speed_mm=FIRST_STEP_MM)
ROOMBA500 = replace(
    ROOMBA600,
    name="roomba500",
    # [500] ends at opcode 168
    opcodes={op: size for op, size in CREATE2.opcodes.items() if op not in (Op.RESET, Op.STOP)},
    songs=16,  # [500]: songs 0 to 15
)
LARGE_RADIUS_MM = 176.5
"""Radius of a 700 or 800 [mm]: half of 353 mm, the largest of the round ones in [W]. No source that
was found has the radius of either series; the larger one keeps more clear of obstacles."""
ROOMBA700 = replace(ROOMBA600, name="roomba700", radius_mm=LARGE_RADIUS_MM)
ROOMBA800 = replace(ROOMBA600, name="roomba800", radius_mm=LARGE_RADIUS_MM)


def step_speed(speed_mm: int) -> int:
    """Return the wheel speed [mm/s] that a Create 2 with stepped speeds drives for a commanded one.

    Its thresholds are 11, 40, 68, 97 ... mm/s; from each of them on, it drives 1 mm/s less than the
    next, and below the first it stands (``STEP_MM``).
    """
    if abs(speed_mm) < FIRST_STEP_MM:
        return 0
    # A threshold is the first whole number of its step
    step = math.floor((abs(speed_mm) - FIRST_STEP_MM) / STEP_MM) + 1
    driven = min(math.ceil(FIRST_STEP_MM + step * STEP_MM) - 1, MAX_WHEEL_SPEED_MM)
    return driven if speed_mm > 0 else -driven
