"""What the base feels: bumpers, cliff and wall sensors, wheel drops, overcurrents, battery."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray, Hazards
from scan3d_twin.sim.world import PREFIX, World

BUMP_FORCE = 0.5
"""Force that presses the bumper [N]; assumption."""
BUMPER_TRAVEL = 0.004
"""How far the robot must back off before the springs release the bumper [m]; assumption."""
WHEEL_DROP = -0.010
"""Drop of a wheel that opens its switch [m]; assumption, of 25 mm of travel."""
CLIFF_DISTANCE = 0.05
"""Distance below a cliff sensor that counts as a cliff [m]; assumption, the floor is at 22 mm."""
WALL_DISTANCE = 0.10
"""Distance beside the wall sensor that counts as a wall [m]; assumption."""
STALL_SPEED = 0.1
"""Share of the commanded speed below which a wheel stands; assumption."""
STALL_TIME = 0.3
"""Time a wheel must stand although it is driven, before its overcurrent shows [s]; assumption."""

_SIDES = ("left", "right")
_CLIFFS = ("cliff_left", "cliff_front_left", "cliff_front_right", "cliff_right")
_DOWN, _GEOM = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)


class Feelers:
    """The sensors of one base in its world."""

    def __init__(self, world: World, period: float, battery_life: float) -> None:
        self._world = world
        self._period = period
        self._battery_life = battery_life
        model, data = world.model, world.data
        self._ints = [model.sensor(f"{PREFIX}bump_{side}").adr[0] for side in _SIDES]
        self._drops = [model.joint(f"{PREFIX}{side}_drop").qposadr[0] for side in _SIDES]
        self._wheels = [model.joint(f"{PREFIX}{side}_wheel").dofadr[0] for side in _SIDES]
        self._cliffs = [data.site(PREFIX + name).xpos for name in _CLIFFS]
        self._wall = data.site(PREFIX + "wall")
        self._place = data.body(PREFIX + "base").xpos
        self._body = model.body(PREFIX + "base").id
        self._pressed_at: list[FloatArray | None] = [None, None]
        self._stalled = [0.0, 0.0]

    def hazards(self, driven: tuple[float, float]) -> Hazards:
        """Return the hazards now; ``driven`` is the wheels' commanded speed [rad/s]."""
        qpos = self._world.data.qpos
        cliffs = [not 0 <= self._distance(at, _DOWN) <= CLIFF_DISTANCE for at in self._cliffs]
        return Hazards(
            self._bumped(0),
            self._bumped(1),
            cliffs[0],
            cliffs[1],
            cliffs[2],
            cliffs[3],
            bool(qpos[self._drops[0]] < WHEEL_DROP),
            bool(qpos[self._drops[1]] < WHEEL_DROP),
            self._stalls(0, driven[0]),
            self._stalls(1, driven[1]),
            self.battery,
        )

    @property
    def battery(self) -> float:
        """State of charge, 0..1."""
        return max(0.0, 1.0 - self._world.time / self._battery_life)

    def wall(self) -> bool:
        """Return whether the wall sensor, which looks right, sees a wall."""
        beam = np.array(self._wall.xmat.reshape(3, 3)[:, 2])
        return 0 <= self._distance(self._wall.xpos, beam) <= WALL_DISTANCE

    def _bumped(self, side: int) -> bool:
        if self._world.data.sensordata[self._ints[side]] > BUMP_FORCE:
            self._pressed_at[side] = np.array(self._place)
        pressed_at = self._pressed_at[side]
        if pressed_at is None:
            return False
        return math.dist(pressed_at[:2], self._place[:2]) < BUMPER_TRAVEL

    def _stalls(self, side: int, driven: float) -> bool:
        """Return whether a wheel has stood still although it is driven."""
        standing = driven and abs(self._world.data.qvel[self._wheels[side]]) < STALL_SPEED * abs(
            driven
        )
        self._stalled[side] = self._stalled[side] + self._period if standing else 0.0
        return self._stalled[side] > STALL_TIME

    def _distance(self, point: FloatArray, direction: FloatArray) -> float:
        """Return the distance from ``point`` (3,) to the scene [m]; -1 where there is none.

        Cast only when a packet is due: as MuJoCo sensors the rays would cost every physics step.
        """
        model, data = self._world.model, self._world.data
        return float(mujoco.mj_ray(model, data, point, direction, None, 1, self._body, _GEOM, None))
