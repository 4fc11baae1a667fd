"""Numbers of the LDROBOT LD06, LD19 and STL27L, shared by twin, driver and emulator.

Sources, named in brackets:

- [manual] LDROBOT LD06 and LD19 development manuals, as resellers copy them;
- [SDK] the maker's decoder ldlidar_stl_ros2, commit bf668a8;
- [list] github.com/kaiaai/awesome-2d-lidars, which warns that it may be wrong: the only source for
  most of the STL27L;
- [assumption] of this project: no source states it.

No figure here was measured on a device.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from scan3d_twin.core.line_grid import make_full_circle
from scan3d_twin.core.types import LidarSpec

TURN_RATE = 10.0
"""Revolutions per second under the lidar's own control, with its PWM pin grounded [Hz] [manual]."""
MAX_TURN_RATE_ERROR = 0.03
"""Share by which the turn rate may be off before the lidar counts as controlled from outside
[assumption]; its own control keeps 10 +- 0.1 Hz [manual]."""
SPARE_PLACES = 0.05
"""Share of places of a line beyond its nominal readings: those of a revolution that is slow by
``MAX_TURN_RATE_ERROR`` [assumption], and four standard deviations of ``revolution`` below."""
BOOT = 0.7
"""Time from power-up to the first packet [s]: 500 ms set-up, 200 ms angle search [manual]."""
SPIN_UP = 3.0
"""Time from power-up until the turn rate is kept [s] [manual]."""


@dataclass(frozen=True, slots=True)
class LdModel:
    """The data sheet of one model.

    Attributes:
        name: Name as the maker prints it.
        baud: Bit rate of its line [bit/s].
        sample_rate: Readings per second [Hz].
        min_range_mm: Shortest distance that is measured [mm].
        max_range_mm: Longest one [mm].
    """

    name: str
    baud: int
    sample_rate: float
    min_range_mm: int
    max_range_mm: int

    @property
    def readings(self) -> float:
        """Nominal number of readings in a revolution."""
        return self.sample_rate / TURN_RATE

    @property
    def link(self) -> str:
        """Name of its only link."""
        return str(self.baud)

    @property
    def spec(self) -> LidarSpec:
        """The grid of its lines, dense enough for a slow revolution."""
        return make_full_circle(
            round(self.readings * (1 + SPARE_PLACES)),
            1.0 / TURN_RATE,
            self.min_range_mm / 1000,
            self.max_range_mm / 1000,
        )


LD19 = LdModel("LD19", 230_400, 4500.0, 20, 12_000)
"""[manual]"""
LD06 = replace(LD19, name="LD06")
"""Bit rate, readings, range and packets are those of the LD19 in both [manual]s, and one decoder of
[SDK] reads both: nothing that an LD06 sends tells it from an LD19."""
STL27L = LdModel("STL27L", 921_600, 21_600.0, 30, 25_000)
"""[SDK] for baud and rate, [list] for the range."""
MODELS = (LD19, STL27L)
"""The models that the rate of their readings tells apart, the most likely first."""

LD_ERRORS: Mapping[str, float | bool] = {
    # Standard deviation of the LD19 from 0.3 to 12 m [manual]; the LD06 is its forerunner with the
    # same packets and range, for which only an accuracy of about 15 mm is stated.
    "sigma": 0.010,
    # Mean error +-45 mm [manual]: a third of it is taken for the standard deviation over units, and
    # a ninth for that over surfaces.
    "unit_offset": 0.015,
    "surface_bias": 0.005,
    # 12 m at 70 % [manual]: (0.7 / pi) / 12^2, see sim/lidar/optics.py.
    "threshold": 0.00155,
}
"""Errors of LD06 and LD19; names as in ``sim/lidar/config.py``."""
STL27L_ERRORS: Mapping[str, float | bool] = {
    # +-15 mm from 0.03 to 2 m [list], taken for three standard deviations, half each for noise and
    # for what does not average out.
    "sigma": 0.005,
    "unit_offset": 0.005,
    "surface_bias": 0.003,
    # 25 m [list], taken at 70 % as for the LD19 [assumption].
    "threshold": 0.000357,
}
"""Errors of the STL27L."""
COMMON_ERRORS: Mapping[str, float | bool] = {
    # A quartz clocks the readings; the rotor keeps 10 +- 0.1 Hz [manual], taken for three standard
    # deviations over units and for as much from turn to turn.
    "period_error": 0.0,
    "revolution": 0.0033,
    "jitter": 0.0003,
    # Stamps in milliseconds [manual].
    "stamp_step": 0.001,
    # A revolution and one packet of 47 bytes at 230400 baud.
    "latency": 0.103,
    # Angles are sent in 0.01 deg, an encoder of about a degree between its marks [assumption].
    "pointing": 0.001,
    # One reading, one pulse: nothing is shared between neighbours, nothing filtered [assumption].
    "neighbours": 0.0,
    "running_median": False,
    "dropout": 0.0,
    "glitch": 0.0,
    "saturation": 1e12,
    # Nothing is known of how it drifts when cold [assumption].
    "warm_up": 0.0,
}
"""Errors that all models share."""
LD_REGISTRATION: Mapping[str, float] = {
    "bias_sigma": 0.005, "offset_sigma": 0.015, "reading_sigma": 0.0,
}  # fmt: skip
"""What registration assumes of LD06 and LD19: ``surface_bias`` and ``unit_offset`` above; no log of
one tells the noise of single readings."""
STL27L_REGISTRATION: Mapping[str, float] = {
    "bias_sigma": 0.003, "offset_sigma": 0.005, "reading_sigma": 0.0,
}  # fmt: skip
"""The same of the STL27L."""
FLOOR_HEIGHT = 0.05
"""Height below which points seen by LD06 and LD19 are floor [m]: at 0.6 m, where half of it counts
and the floor is seen at 30 deg, an offset of 15 mm and three standard deviations of the noise raise
the floor by 23 mm."""
EMULATED_INTENSITY = 200
"""Intensity of an emulated reading, 0 to 255: that of a white surface within 6 m [assumption]."""
