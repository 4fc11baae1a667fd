"""From the lidar's motion to the readings of its lines: geometry, optics, firmware."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.types import FloatArray, IntArray, LidarSpec, read_only
from scan3d_twin.devices.device import LidarSensor
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.lidar.firmware import Light, read
from scan3d_twin.sim.lidar.footprint import mix, offsets
from scan3d_twin.sim.lidar.glass import Panes
from scan3d_twin.sim.lidar.noise import Draws
from scan3d_twin.sim.lidar.optics import Materials
from scan3d_twin.sim.ray_casting import Hits, RayCaster
from scan3d_twin.sim.turntable.body import CARRIED_SITE, HINGE
from scan3d_twin.sim.world import YAW_BASE, robot_spec

CHUNK = 12
"""Lines computed at once; more do not fit the processor's cache."""


def beam_directions(elevations: FloatArray) -> FloatArray:
    """Return unit beam directions (n, 3) in the lidar's frame."""
    return np.stack([np.cos(elevations), np.zeros_like(elevations), np.sin(elevations)], axis=-1)


@cache
def _posed_robot(robot: str, pattern: str) -> tuple[Any, Any]:
    """Return the model and data of a ``robot`` alone, at rest, with a turntable on a hinge."""
    model = robot_spec(robot, pattern, hinged=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def own_housing(
    robot: str | None,
    elevations: FloatArray,
    pattern: str = YAW_BASE,
    angle: float = 0.0,
    turn: FloatArray | None = None,
) -> Hits:
    """Return what beams at ``elevations`` (n,) [rad] see of the robot itself.

    It moves with the lidar, so this is constant, but for the ``angle`` of a turntable [rad].
    Without a ``robot`` they see nothing of it. The lidar is turned by ``turn`` (3, 3) on its mount.
    """
    n = len(elevations)
    if robot is None:
        return Hits(np.full(n, np.inf), np.zeros((n, 3)), np.full(n, -1, np.int64))
    model, data = _posed_robot(robot, pattern)
    geoms, distances, normals = np.zeros(n, np.int32), np.zeros(n), np.zeros(3 * n)
    lidar, own_body, rays = data.site("lidar"), "mast", beam_directions(elevations)
    rays = rays if turn is None else rays @ turn.T
    if pattern != YAW_BASE:
        data.joint(HINGE).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        lidar, own_body = data.site(CARRIED_SITE), "turntable"
        rays = rays @ lidar.xmat.reshape(3, 3).T
    mujoco.mj_multiRay(
        model, data, lidar.xpos, rays.ravel(), None, True, model.body(own_body).id, geoms,
        distances, normals, n, 10.0,
    )  # fmt: skip
    facing = normals.reshape(n, 3)
    if pattern != YAW_BASE:
        facing = facing @ lidar.xmat.reshape(3, 3)
    facing = facing if turn is None else facing @ turn
    return Hits(np.where(geoms < 0, np.inf, distances), facing, np.full(n, -1, np.int64))


@dataclass(frozen=True, slots=True)
class Evidence:
    """What lay behind a line's readings; for evaluation only, no planner sees it.

    Attributes:
        intensity: Power of the return, in units of a white surface at 1 m times 1 / pi (n_beams,).
        distances: Noise-free distance along the middle of the beam (n_beams,) [m]; inf for a miss.
        geoms: Geom ids in the scene's model (n_beams,); -1 for a miss or the robot itself.
        normals: Of the surface, outwards, in ``map`` (n_beams, 3); 0 for a miss or the robot.
        positions: The lidar's place at the beam's time, in ``map`` (n_beams, 3) [m].
        directions: Of the beam, in ``map`` (n_beams, 3).
    """

    intensity: FloatArray
    distances: FloatArray
    geoms: IntArray
    normals: FloatArray
    positions: FloatArray
    directions: FloatArray


@dataclass(frozen=True, slots=True)
class Readings:
    """Lines as the sensor reports them.

    Attributes:
        ranges: (m, n_beams) [m]; NaN where there is none.
        codes: (m, n_beams).
        evidence: Per line; empty unless it was asked for.
    """

    ranges: FloatArray
    codes: IntArray
    evidence: tuple[Evidence, ...]


@dataclass(frozen=True)
class Fan:
    """Beams at certain elevations, with all of them that does not change.

    Attributes:
        beams: Directions in the lidar's frame (n_beams, 3).
        own: What they get of the robot itself, arrays (1, n_beams).
        free: Indices of the beams that pass the robot.
        sub_rays: The sub-rays of those, in the lidar's frame (3, K, n_free).
        sine: Of their elevations (n_free,).
        cosine: Of their elevations (n_free,).
    """

    beams: FloatArray
    own: Light
    free: slice | IntArray
    sub_rays: FloatArray
    sine: FloatArray
    cosine: FloatArray


class Scanner:
    """Everything about the sensor that does not change while it runs."""

    def __init__(
        self,
        scene_model: Any,
        robot: str | None,
        spec: LidarSpec,
        config: LidarModelConfig,
        caster: RayCaster,
        rng: np.random.Generator,
        sensor: LidarSensor,
        pattern: str = YAW_BASE,
        turn: FloatArray | None = None,
    ) -> None:
        self.spec = spec
        self.sensor = sensor
        self.config = config
        self.caster = caster
        self.materials = Materials.of(scene_model, config)
        self._panes = Panes.of(scene_model, caster)
        self.surface_bias = config.surface_bias * rng.standard_normal(scene_model.ngeom + 1)
        self._robot, self.pattern, self._turn = robot, pattern, turn
        self._usual = self.make_fan(spec.elevations)

    @property
    def beams(self) -> FloatArray:
        """Directions of the beams of ``spec`` in the lidar's frame (n_beams, 3)."""
        return self._usual.beams

    def make_fan(self, elevations: FloatArray, angle: float = 0.0) -> Fan:
        """Return beams at ``elevations`` (n_beams,) [rad], at an ``angle`` of the turntable."""
        # Find what they see of the robot itself
        beams = read_only(beam_directions(elevations))
        own = own_housing(self._robot, elevations, self.pattern, angle, self._turn)
        cosines = np.abs(np.einsum("ni,ni->n", own.normals, beams))
        light = Light(
            own.distances[None],
            self.materials.power(own.geoms, cosines, own.distances)[None],
            cosines[None],
            np.full((1, len(elevations)), self.surface_bias[-1]),
        )

        # Spread those that pass it
        free = _range(np.flatnonzero(np.isinf(own.distances)))
        passing = elevations[free]
        along, across = offsets(self.config).T[:, :, None]
        angles = passing + along
        sub_rays = np.stack(
            [
                np.cos(across) * np.cos(angles),
                np.broadcast_to(np.sin(across), angles.shape),
                np.cos(across) * np.sin(angles),
            ]
        )
        sine, cosine = read_only(np.sin(passing)), read_only(np.cos(passing))
        return Fan(beams, light, free, read_only(sub_rays), sine, cosine)

    def measure(
        self,
        qpos: FloatArray,
        positions: FloatArray,
        rotations: FloatArray,
        draws: Draws,
        drift: FloatArray,
        *,
        fan: Fan | None = None,
        evidence: bool = False,
    ) -> Readings:
        """Return the readings of m lines.

        Args:
            qpos: Positions of the scene's moving objects.
            positions: The lidar's position at each beam's time (m, n_beams, 3) [m].
            rotations: The lidar's attitude at each beam's time (m, n_beams, 3, 3).
            draws: The lines' chance.
            drift: Error of each whole line (m,) [m].
            fan: Their beams; None is those of ``spec``.
            evidence: Keep what lay behind the readings, for evaluation.
        """
        fan = self._usual if fan is None else fan
        rays = self._directions(rotations[:, fan.free], self._steer(fan, draws))
        light, hits, readings = self._read(fan, qpos, positions[:, fan.free], rays, draws, drift)
        if not evidence:
            return readings
        return replace(readings, evidence=_collect_evidence(fan, light, hits, positions, rotations))

    def measure_upright(
        self,
        qpos: FloatArray,
        positions: FloatArray,
        heading: tuple[FloatArray, FloatArray],
        draws: Draws,
        drift: FloatArray,
    ) -> Readings:
        """Return what ``measure`` does for a lidar that stands upright.

        Its ``heading`` at each beam's time is given by cosine and sine (m, n_beams).
        """
        fan = self._usual
        c, s = (part[:, fan.free] for part in heading)
        x, y, z = self._steer(fan, draws)
        rays = np.empty((len(x), *c.shape, 3))
        rays[..., 0], rays[..., 1], rays[..., 2] = x * c - y * s, x * s + y * c, z
        return self._read(fan, qpos, positions[:, fan.free], rays, draws, drift)[2]

    def _read(
        self,
        fan: Fan,
        qpos: FloatArray,
        at: FloatArray,
        rays: FloatArray,
        draws: Draws,
        drift: FloatArray,
    ) -> tuple[Light, Hits, Readings]:
        """Cast ``rays`` (K, m, n_free, 3) from ``at`` (m, n_free, 3) and read what comes back.

        Returns:
            The light of each beam, what the middle of each free beam hit, and the readings.
        """
        if rays.size == 0:
            return self._read_housing(fan, draws, drift)
        directions = rays.reshape(-1, 3)
        origins = np.broadcast_to(at, rays.shape).reshape(-1, 3)
        hits = self.caster.cast(qpos, origins, directions)
        cosines = np.abs(np.einsum("ni,ni->n", hits.normals, directions))
        power = self.materials.power(hits.geoms, cosines, hits.distances)
        shape = (len(rays), at.shape[0] * at.shape[1])
        mixed = mix(hits.distances.reshape(shape), power.reshape(shape), self.config, self.sensor)
        if self._panes is not None:
            optics = self.config, self.sensor
            hits, cosines, mixed = self._panes.look_through(
                qpos, (origins, directions), hits, cosines, self.materials, shape[1], optics, mixed
            )
        middle = slice(0, shape[1])
        bias = self.surface_bias.take(hits.geoms[middle])
        light = _add_housing(fan, len(at), mixed.distances, mixed.power, cosines[middle], bias)
        row, column = np.divmod(mixed.broken, at.shape[1])
        broken = (row, np.arange(len(fan.beams))[fan.free][column])
        ranges, codes = read(light, (broken, mixed.codes), draws, drift, self.config, self.sensor)
        behind = Hits(hits.distances[middle], hits.normals[middle], hits.geoms[middle])
        return light, behind, Readings(ranges, codes, ())

    def _read_housing(
        self, fan: Fan, draws: Draws, drift: FloatArray
    ) -> tuple[Light, Hits, Readings]:
        """Return what ``_read`` does for beams of which none passes the robot."""
        none, whole = np.empty(0), np.empty(0, np.int64)
        light = _add_housing(fan, len(drift), none, none, none, none)
        broken = ((whole, whole), whole)
        ranges, codes = read(light, broken, draws, drift, self.config, self.sensor)
        return light, Hits(none, np.empty((0, 3)), whole), Readings(ranges, codes, ())

    def _steer(self, fan: Fan, draws: Draws) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the sub-rays of lines in the lidar's frame, by component (K, m or 1, n_free) each.

        All of a beam's light is moved by its pointing error; errors are small, so vectors keep
        their length within 1e-5.
        """
        along, across, upwards = fan.sub_rays[:, :, None]
        if draws.pointing is None:
            return along, across, upwards
        turn = self.config.pointing * draws.pointing[:, fan.free]
        return along - turn * fan.sine, across, upwards + turn * fan.cosine

    def _directions(
        self, rotations: FloatArray, sub_rays: tuple[FloatArray, FloatArray, FloatArray]
    ) -> FloatArray:
        """Return ``sub_rays`` in ``map`` (K, m, n_free, 3), turned by ``rotations``.

        Components come first while they are worked out: loops over 3 numbers take thrice as long.
        """
        ahead, left, up = np.ascontiguousarray(rotations.transpose(3, 2, 0, 1))[:, :, None]
        along, across, upwards = sub_rays
        rays = along * ahead
        rays += upwards * up
        if len(along) > 1:
            rays += across * left
        result = np.empty((*rays.shape[1:], 3))
        for component, values in enumerate(rays):
            result[..., component] = values
        return result


def _add_housing(fan: Fan, m: int, *arrays: FloatArray) -> Light:
    """Return ``arrays`` (m * n_free,) of the free beams as (m, n_beams), with the robot's."""
    result = []
    for own, array in zip(fan.own.arrays(), arrays, strict=True):
        whole = np.empty((m, own.shape[1]))
        whole[:] = own
        whole[:, fan.free] = array.reshape(m, -1)
        result.append(whole)
    return Light(*result)


def _collect_evidence(
    fan: Fan, light: Light, hits: Hits, positions: FloatArray, rotations: FloatArray
) -> tuple[Evidence, ...]:
    m, n = light.distances.shape
    distances = np.repeat(fan.own.distances, m, axis=0)
    geoms, normals = np.full((m, n), -1), np.zeros((m, n, 3))
    distances[:, fan.free] = hits.distances.reshape(m, -1)
    geoms[:, fan.free] = hits.geoms.reshape(m, -1)
    normals[:, fan.free] = hits.normals.reshape(m, -1, 3)
    directions = np.einsum("mnij,nj->mni", rotations, fan.beams)
    rows = (light.power, distances, geoms, normals, positions, directions)
    kinds = (np.float64, np.float64, np.int64, np.float64, np.float64, np.float64)
    return tuple(
        Evidence(*(read_only(row[k], kind) for row, kind in zip(rows, kinds, strict=True)))
        for k in range(m)
    )


def _range(indices: IntArray) -> slice | IntArray:
    """Return ``indices`` (n,) as a slice where they have no gap; it costs no copies."""
    if len(indices) == 0:
        return slice(0, 0)
    first, last = int(indices[0]), int(indices[-1])
    return slice(first, last + 1) if last - first + 1 == len(indices) else indices
