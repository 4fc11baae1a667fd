"""Safety sensors of the base: bumpers, cliffs, wall, wheel drops, overcurrents, battery."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray, Hazards
from scan3d_twin.sim.scenes.visibility import is_visible
from scan3d_twin.sim.world import PREFIX, World

BUMP_FORCE = 0.5
"""Force that presses the bumper [N]; assumption."""
BUMPER_TRAVEL = 0.004
"""Distance of backing off after which the springs release the bumper [m]; assumption."""
WHEEL_DROP = -0.010
"""Drop of a wheel that opens its switch [m]; assumption, of 25 mm of travel."""
CLIFF_DISTANCE = 0.05
"""Distance below a cliff sensor that counts as a cliff [m]; assumption, the floor is at 22 mm."""
WALL_DISTANCE = 0.10
"""Distance beside the wall sensor that counts as a wall [m]; assumption."""
STALL_SHARE = 0.1
"""Share of the commanded speed below which a wheel counts as stalled; assumption."""
STALL_TIME = 0.3
"""Time for which a driven wheel must be stalled before its overcurrent shows [s]; assumption."""

BATTERY_CAPACITY = 2700
"""Capacity of the battery [mAh]; NiMH pack of the Create 2."""

_FLAGS = tuple(field.name for field in fields(Hazards) if field.name != "battery")
_SIDES = ("left", "right")
_CLIFFS = ("cliff_left", "cliff_front_left", "cliff_front_right", "cliff_right")
_DOWN, _GEOM = np.array([0.0, 0.0, -1.0]), np.zeros(1, np.int32)


class SafetySensors:
    """The safety sensors of one base in its world."""

    def __init__(self, world: World, period: float, battery_life: float) -> None:
        # Keep world and battery
        self._world = world
        self._period = period
        self._battery_life = battery_life

        # Find its parts in the model
        model, data = world.model, world.data
        first = int(model.sensor(f"{PREFIX}bump_left").adr[0])
        self._forces = data.sensordata[first : first + 2]  # left and right
        self._drops = [int(model.joint(f"{PREFIX}{side}_drop").qposadr[0]) for side in _SIDES]
        self._wheels = [int(model.joint(f"{PREFIX}{side}_wheel").dofadr[0]) for side in _SIDES]
        self._qpos, self._qvel = data.qpos, data.qvel
        sites = [int(model.site(PREFIX + name).id) for name in _CLIFFS]
        self._sites = data.site_xpos[min(sites) : max(sites) + 1]
        self._cliffs = [site - min(sites) for site in sites]
        self._wall = data.site(PREFIX + "wall")
        self._place = data.body(PREFIX + "base").xpos
        self._body = model.body(PREFIX + "base").id
        self._plane = _even_floor_reach(model)

        # Reset the state of the sensors
        self._pressed_at: list[FloatArray | None] = [None, None]
        self._stalled = [0.0, 0.0]
        self._calm = Hazards()

    def hazards(self, driven: tuple[float, float]) -> Hazards:
        """Return the present hazards; ``driven`` is the wheels' commanded speed [rad/s]."""
        (left, right), sites, qpos = self._forces.tolist(), self._sites.tolist(), self._qpos
        flags = (
            self._is_bumped(0, left),
            self._is_bumped(1, right),
            *[self._over_cliff(*sites[site]) for site in self._cliffs],
            *[qpos.item(drop) < WHEEL_DROP for drop in self._drops],
            self._stalls(0, driven[0]),
            self._stalls(1, driven[1]),
        )
        battery = self.battery
        if True in flags:
            return Hazards(**dict(zip(_FLAGS, flags, strict=True)), battery=battery)
        if battery != self._calm.battery:
            self._calm = Hazards(battery=battery)
        return self._calm

    @property
    def battery(self) -> float:
        """State of charge, 0..1, in whole mAh as packet 25 states it."""
        left = 1.0 - self._world.time / self._battery_life
        return max(0.0, math.ceil(left * BATTERY_CAPACITY) / BATTERY_CAPACITY)

    def wall(self) -> bool:
        """Return whether the wall sensor, which points right, sees a wall."""
        beam = np.array(self._wall.xmat.reshape(3, 3)[:, 2])
        return 0 <= self._distance(self._wall.xpos, beam) <= WALL_DISTANCE

    def _is_bumped(self, side: int, force: float) -> bool:
        if force > BUMP_FORCE:
            self._pressed_at[side] = np.array(self._place)
        pressed_at = self._pressed_at[side]
        if pressed_at is None:
            return False
        return math.dist(pressed_at[:2], self._place[:2]) < BUMPER_TRAVEL

    def _stalls(self, side: int, driven: float) -> bool:
        """Return whether a driven wheel has been stalled for longer than ``STALL_TIME``."""
        if driven and abs(self._qvel.item(self._wheels[side])) < STALL_SHARE * abs(driven):
            self._stalled[side] += self._period
        else:
            self._stalled[side] = 0.0
        return self._stalled[side] > STALL_TIME

    def _over_cliff(self, x: float, y: float, z: float) -> bool:
        """Return whether a cliff sensor at a place [m] sees no floor near by."""
        reach = self._plane
        if 0 < z <= CLIFF_DISTANCE and -reach < x < reach and -reach < y < reach:
            return False
        return not 0 <= self._distance(np.array([x, y, z]), _DOWN) <= CLIFF_DISTANCE

    def _distance(self, point: FloatArray, direction: FloatArray) -> float:
        """Return the distance from ``point`` (3,) to the scene [m]; -1 where there is none.

        Rays are cast only when a packet is due; MuJoCo sensors would cast them every physics step.
        """
        model, data = self._world.model, self._world.data
        return float(mujoco.mj_ray(model, data, point, direction, None, 1, self._body, _GEOM, None))


def _even_floor_reach(model: Any) -> float:
    """Return how far a plane at z = 0 extends from the origin [m]; 0 where there is none.

    Above such a plane a cliff sensor needs no ray.
    """
    reach = 0.0
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        level = model.geom_bodyid[geom] == 0 and model.geom_pos[geom, 2] == 0
        centred = not model.geom_pos[geom, :2].any() and model.geom_quat[geom, 0] == 1
        if level and centred and is_visible(model, int(geom)):
            sides = model.geom_size[geom, :2]
            reach = max(reach, float(np.where(sides > 0, sides, np.inf).min()))
    return reach
