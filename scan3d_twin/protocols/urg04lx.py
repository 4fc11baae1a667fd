"""Constants of the Hokuyo URG-04LX and its scan modes, shared by twin, driver and emulator.

Sources: URG Series Communication Protocol Specification SCIP-Version 2.0 (C-42-03320B), parameters
of ``PP`` in brackets; URG-04LX data sheet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

STEPS_PER_TURN = 1024
"""Angular resolution [ARES]: 360 deg / 1024 = 0.3516 deg."""
FIRST_STEP = 44
"""First step measured [AMIN]."""
FRONT_STEP = 384
"""Step that looks ahead [AFRT]."""
LAST_STEP = 725
"""Last step measured [AMAX]."""
MIN_RANGE_MM = 20
"""Shortest distance [DMIN]; smaller values are error codes."""
MAX_RANGE_MM = 4095
"""Longest distance of the data sheet and of the two-character encoding."""
TRUSTED_RANGE_MM = 4000
"""Longest distance for which the data sheet states an accuracy (1 %)."""
REVOLUTION = 0.1
"""Time of one turn of the mirror at 600 rpm [SCAN] [s]; the time stamp is that of step 0."""

NO_RETURN = 0
"""Error code "possibly 22 m": nothing came back."""


@dataclass(frozen=True, slots=True)
class ScanMode:
    """Which steps are sent and how often.

    Attributes:
        first_step: First step of a line.
        last_step: Last step of a line, inclusive.
        turns_per_line: Revolutions of the mirror per line sent; 1 is every revolution.
    """

    first_step: int
    last_step: int
    turns_per_line: int

    @property
    def steps(self) -> range:
        """The steps of a line."""
        return range(self.first_step, self.last_step + 1)

    @property
    def line_period(self) -> float:
        """Time between two lines [s]."""
        return self.turns_per_line * REVOLUTION


LINKS = {
    "usb": ScanMode(FIRST_STEP, LAST_STEP, 1),
    # 115200 baud carries 357 three-character steps in 100 ms; 682 steps take 186 ms.
    "115200": ScanMode(FRONT_STEP - 178, FRONT_STEP + 178, 1),
    "115200-full": ScanMode(FIRST_STEP, LAST_STEP, 2),
}
"""Scan mode by the name of the link."""


def step_angle(step: int) -> float:
    """Return the beam's angle at ``step`` [rad]; 0 ahead, positive counter-clockwise from above."""
    return (step - FRONT_STEP) * math.tau / STEPS_PER_TURN


def step_time(step: int) -> float:
    """Return the time of ``step`` after step 0 [s]."""
    return step / STEPS_PER_TURN * REVOLUTION
