"""Ranges of random scenes: what may be drawn, with the limits of each range."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from scan3d_twin.core.config import Tour
from scan3d_twin.core.errors import ConfigError, UnknownNameError

Interval = tuple[float, float]
Shape = Literal["box", "boxes", "cylinder", "sine", "steps", "l_shape", "u_shape", "combination"]


def shape_names() -> tuple[Shape, ...]:
    """Return the names of the shapes that a random target can have."""
    return get_args(Shape)


@dataclass(frozen=True, slots=True)
class SceneRanges:
    """Ranges of random scenes: uniform intervals (low, high) in SI units.

    Sizes are those of furniture and boxes that a robot 35 cm high can see completely: assumptions.
    """

    shapes: tuple[Shape, ...] = field(default_factory=shape_names)
    """Shapes of the target, equally likely."""
    tours: tuple[Tour, ...] = ("front", "full")
    """Whether it is scanned from the front or all round, equally likely."""
    width: Interval = (0.35, 1.50)
    """Width of the target across the robot's view [m]; a sweep covers 1.15 m at 1 m standoff."""
    depth: Interval = (0.20, 0.60)
    """Depth of each part along the robot's view [m]."""
    height: Interval = (0.30, 0.90)
    """Height of each part [m]; the window of 75 deg ends at 1.07 m at a standoff of 1 m."""
    gap: Interval = (0.04, 0.12)
    """Gap between parts [m]; from 0.20 m on they count as two targets."""
    setback: Interval = (0.0, 0.15)
    """Setback of a part's front behind the foremost one [m]; paper, Fig. 13."""
    radius: Interval = (0.12, 0.35)
    """Radius of cylinders [m]."""
    amplitude: Interval = (0.01, 0.03)
    """Amplitude of a wavy side [m]; paper, Fig. 10: 0.02."""
    period: Interval = (0.08, 0.25)
    """Period of a wavy side [m]; paper, Fig. 10: 0.08."""
    rise: Interval = (0.12, 0.20)
    """Rise of a step [m]; DIN 18065: 0.14 to 0.20."""
    going: Interval = (0.15, 0.30)
    """Going (depth) of a step [m]; DIN 18065: 0.23 to 0.32."""
    turn: Interval = (-0.35, 0.35)
    """Heading of a target for tour front [rad]; others have any heading."""
    start: Interval = (1.0, 1.4)
    """Distance from the target's circumcircle to the robot's start [m]."""
    heading: Interval = (-0.3, 0.3)
    """The robot's heading at its start, relative to the target's middle [rad]."""
    standoff: Interval = (0.9, 1.1)
    """Scanning distance [m]; the built-in scenes have 1.0."""
    walls: float = 0.75
    """Share of the scenes that lie in a room, 0..1."""
    spare: Interval = (0.0, 0.8)
    """Room beyond the robot's path round the target, on each side [m]."""
    clutter: tuple[int, int] = (0, 6)
    """Number of objects of clutter; fewer where they do not fit."""
    clutter_radius: Interval = (0.06, 0.17)
    """Radius of these objects [m]."""
    matte: float = 0.60
    """Share of matte surfaces, 0..1."""
    dark: float = 0.15
    """Share of dark matte surfaces, 0..1."""
    glossy: float = 0.15
    """Share of glossy plastic, 0..1; the rest is chrome."""
    albedo: Interval = (0.40, 0.90)
    """Reflectance of matte and glossy surfaces."""
    dark_albedo: Interval = (0.10, 0.25)
    """Reflectance of dark surfaces; the lidar of the paper sees 10 % grey to 4 m."""
    gloss: Interval = (0.20, 0.45)
    """Roughness of glossy plastic."""
    chrome: Interval = (0.30, 0.50)
    """Roughness of chrome: a cylinder loses 15 to 0 % of its readings at 1.2 m."""
    friction: Interval = (0.40, 1.00)
    """Sliding friction between floor and tyres."""

    def __post_init__(self) -> None:
        # Check the intervals
        for name in _LIMITS:
            _check_interval(name, getattr(self, name))

        # Check shapes and tours
        _require(bool(self.shapes) and bool(self.tours), "random.shapes and random.tours: name one")
        for shape in self.shapes:
            if shape not in shape_names():
                raise UnknownNameError("shape", shape, shape_names())
        for tour in self.tours:
            if tour not in ("front", "full"):
                raise UnknownNameError("tour", tour, ("front", "full"))

        # Check the shares
        for name in ("walls", "matte", "dark", "glossy"):
            share = getattr(self, name)
            _require(0.0 <= share <= 1.0, f"random.{name} must be in [0, 1], got {share:g}")
        rest = 1.0 - self.matte - self.dark - self.glossy
        _require(rest > -1e-9, "random.matte + random.dark + random.glossy must be <= 1")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ConfigError(message)


_LIMITS: dict[str, Interval] = {
    "width": (0.1, 3.0), "depth": (0.05, 2.0), "height": (0.1, 2.0), "gap": (0.0, 0.15),
    "setback": (0.0, 0.5), "radius": (0.05, 1.0), "amplitude": (0.0, 0.05), "period": (0.04, 1.0),
    "rise": (0.02, 0.5), "going": (0.05, 1.0), "turn": (-math.pi, math.pi), "start": (0.5, 2.0),
    "heading": (-math.pi, math.pi), "standoff": (0.5, 2.0), "spare": (0.0, 3.0),
    "clutter": (0, 50), "clutter_radius": (0.02, 0.5), "albedo": (0.0, 1.0),
    "dark_albedo": (0.0, 1.0), "gloss": (0.05, 1.0), "chrome": (0.05, 1.0), "friction": (0.1, 2.0),
}  # fmt: skip
"""Limits of the intervals: the range in which robot and lidar work."""


def _check_interval(name: str, value: tuple[float, float]) -> None:
    low, high = _LIMITS[name]
    _require(
        low <= value[0] <= value[1] <= high,
        f"random.{name} must be (low, high) within {low:g} and {high:g}, got {value}",
    )
