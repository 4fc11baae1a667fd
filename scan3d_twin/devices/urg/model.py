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
LAST_POINT = 768
"""Last step that can be requested, the first being 0; only [AMIN] to [AMAX] are measured."""
MIN_RANGE_MM = 20
"""Shortest distance [DMIN]; smaller values are error codes."""
MAX_RANGE_MM = 4095
"""Longest distance, of the data sheet and of the two-character encoding."""
DETECTED_RANGE_MM = 5600
"""Distance beyond which a detected return is an error code [DMAX]; a log holds none beyond."""
TRUSTED_RANGE_MM = 4000
"""Longest distance for which the data sheet states an accuracy (1 %)."""
REVOLUTION = 0.1
"""Period of the mirror at 600 rpm [SCAN] [s]; timestamps are those of step 0."""

MODULATIONS = (46.55e6, 53.2e6)
"""Frequencies of the light's two modulations [Hz]; their phases repeat together every 22.5 m."""
REPLY_LATENCY = 0.101
"""Time from step 0 of a turn to the start of its reply [s]; a single sample in a capture of
firmware 3.1.04 over USB."""
COMMAND_TICK = 0.0998
"""Interval at which commands are answered, once per turn [s]; 9 replies in the same capture."""

NO_RETURN = 0
"""Error code "possibly 22 m": nothing came back, or the phases of the two waves do not fit."""
WEAK_RETURN = 1
"""Error code: low intensity (1 and 2); a log holds 1 three times as often."""
TOO_FAR = 6
"""Error code: "others", in earlier documents "at 5.7 m". In a log of a standing sensor 90 % of them
stay and the others become 0, never a distance, as of a wall beyond the longest distance."""
NEIGHBOURS_INVALID = 7
"""Error code: the steps before and after are invalid."""
AMPLITUDES_DIFFER = 8
"""Error code: the intensities of the two waves differ."""
GLITCH = 10
"""Error code: others (10 to 17)."""
TOO_STRONG = 18
"""Error code: strong reflection."""


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
"""Scan modes by the name of the link."""


def step_angle(step: int) -> float:
    """Return the beam's angle at ``step`` [rad]; 0 ahead, positive counter-clockwise from above."""
    return (step - FRONT_STEP) * math.tau / STEPS_PER_TURN


def step_time(step: int) -> float:
    """Return the time of ``step`` after step 0 [s]."""
    return step / STEPS_PER_TURN * REVOLUTION
