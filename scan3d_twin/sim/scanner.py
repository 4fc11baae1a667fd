"""From the lidar's motion to the readings of one line: geometry, optics, quantisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import VALID, BoolArray, FloatArray, IntArray, LidarSpec, read_only
from scan3d_twin.protocols import urg04lx
from scan3d_twin.sim.casters import Hits, RayCaster
from scan3d_twin.sim.config import LidarModelConfig, RobotName
from scan3d_twin.sim.optics import Materials, detected, perturbed
from scan3d_twin.sim.world import robot_spec


def lidar_spec(link: str) -> LidarSpec:
    """Return the geometry of the lines that come over ``link``."""
    mode = urg04lx.LINKS[link]
    return LidarSpec(
        elevations=read_only([urg04lx.step_angle(step) for step in mode.steps]),
        beam_times=read_only([urg04lx.step_time(step) for step in mode.steps]),
        line_period=mode.line_period,
        min_range=urg04lx.MIN_RANGE_MM / 1000,
        max_range=urg04lx.MAX_RANGE_MM / 1000,
    )


def beam_directions(elevations: FloatArray) -> FloatArray:
    """Return unit beam directions (n, 3) in the lidar's frame."""
    return np.stack([np.cos(elevations), np.zeros_like(elevations), np.sin(elevations)], axis=-1)


def own_housing(robot: RobotName, elevations: FloatArray) -> Hits:
    """Return what the beams see of the robot itself; it moves with the lidar, so it is constant."""
    model = robot_spec(robot).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    n = len(elevations)
    geoms, distances, normals = np.zeros(n, np.int32), np.zeros(n), np.zeros(3 * n)
    rays = beam_directions(elevations).ravel()
    origin, mast = data.site("lidar").xpos, model.body("mast").id
    mujoco.mj_multiRay(
        model, data, origin, rays, None, True, mast, geoms, distances, normals, n, 10.0
    )
    reach = np.where(geoms < 0, np.inf, distances)
    return Hits(reach, normals.reshape(n, 3), np.full(n, -1, np.int64))


@dataclass(frozen=True)
class Scanner:
    """Everything about the sensor that does not change while it runs.

    Attributes:
        spec: Geometry of its lines.
        config: Noise, dropouts and losses.
        beams: Directions of the beams in the lidar's frame (n_beams, 3).
        caster: Casts rays against the scene.
        materials: Optical properties of the caster's geoms.
        housing: What the beams see of the robot itself.
    """

    spec: LidarSpec
    config: LidarModelConfig
    beams: FloatArray
    caster: RayCaster
    materials: Materials
    housing: Hits

    @staticmethod
    def create(
        scene_model: Any, robot: RobotName, link: str, config: LidarModelConfig, caster: RayCaster
    ) -> Scanner:
        """Return the scanner of ``robot`` for a scene without a robot in it."""
        spec = lidar_spec(link)
        materials = Materials.of(scene_model, config)
        beams = read_only(beam_directions(spec.elevations))
        return Scanner(spec, config, beams, caster, materials, own_housing(robot, spec.elevations))

    def measure(
        self,
        qpos: FloatArray,
        positions: FloatArray,
        rotations: FloatArray,
        rng: np.random.Generator,
    ) -> tuple[FloatArray, IntArray]:
        """Return the readings of a line.

        Args:
            qpos: Positions of the scene's moving objects.
            positions: The lidar's position at each beam's time (n_beams, 3) [m].
            rotations: The lidar's attitude at each beam's time (n_beams, 3, 3).
            rng: Of this line.

        Returns:
            Ranges (n_beams,) [m], NaN where there is none, and codes (n_beams,).
        """
        directions = np.einsum("nij,nj->ni", rotations, self.beams)
        hits = self.caster.cast(qpos, positions, directions)
        cosines = np.einsum("ni,ni->n", hits.normals, directions)
        own = self.housing.distances < hits.distances
        distances = np.where(own, self.housing.distances, hits.distances)
        geoms = np.where(own, -1, hits.geoms)
        cosines = np.where(own, np.einsum("ni,ni->n", self.housing.normals, self.beams), cosines)
        power = self.materials.power(geoms, cosines, distances)
        draws = rng.standard_normal((2, len(directions)))
        seen = detected(power, draws[0], self.config) & np.isfinite(distances)
        distances = np.where(seen, distances, 0.0)
        return _reading(perturbed(distances, power, draws[1], self.config), seen)


def _reading(distances: FloatArray, seen: BoolArray) -> tuple[FloatArray, IntArray]:
    """Return ``distances`` (n,) [m] as the sensor reports them: whole millimetres, or a code."""
    distances_mm = np.round(distances * 1000)
    valid = seen & (distances_mm >= urg04lx.MIN_RANGE_MM) & (distances_mm <= urg04lx.MAX_RANGE_MM)
    ranges = np.where(valid, distances_mm / 1000, np.nan)
    return ranges, np.where(valid, VALID, urg04lx.NO_RETURN)
