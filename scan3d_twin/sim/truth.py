"""The ground truth of the twin, for evaluation only; no planner sees it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import mujoco
import numpy as np

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.lidar.glass import Panes
from scan3d_twin.sim.lidar.scanner import Evidence
from scan3d_twin.sim.ray_casting import RayCaster
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.scenes.surface_samples import bounding_points, sample_geom

MIN_FACE_HEIGHT = 0.002
"""Height below which a face that points down lies on the floor [m]."""
SHOWN_SPACING = 0.05
"""Distance of the samples by which a target is looked for from the start [m]."""
AT_SURFACE = 0.01
"""Largest distance of a hit from the sample that it shows [m]; assumption."""


class PoseHistory(Protocol):
    """The true poses over time: ``PoseTrace`` with physics, ``KinematicWorld`` without."""

    @property
    def latest(self) -> float:
        """Time of the latest pose [s]."""
        ...

    def base_poses(self, times: FloatArray) -> FloatArray:
        """Return x, y [m] and yaw [rad] (n, 3) of ``T_map_base`` at ``times`` (n,) [s]."""
        ...

    def scene_qpos(self) -> FloatArray:
        """Return the positions of the scene's moving objects."""
        ...


class Truth:
    """The true poses and surfaces, in ``map``, the scene's own frame."""

    def __init__(
        self,
        scene: Scene,
        world: PoseHistory,
        caster: RayCaster,
        evidence: Callable[[], Evidence | None],
    ) -> None:
        self._scene = scene
        self._world = world
        self._caster = caster
        self._panes = Panes.of(scene.model, caster)
        self._evidence = evidence
        self._T_map_odom = self.pose_at(0.0)

    @property
    def spawn(self) -> Pose2:
        """The robot's start in the scene, ``T_map_base``."""
        return self._scene.spawn

    @property
    def front(self) -> Pose2 | None:
        """Middle of the target's front, +x outwards; None when it is scanned all round."""
        return self._scene.front

    @property
    def latest(self) -> float:
        """Time until which the poses are known, on the clock of the robot [s]."""
        return self._world.latest

    def pose_at(self, stamp: float) -> Pose2:
        """Return the true ``T_map_base`` at ``stamp`` [s]."""
        return Pose2(*self.poses_at(np.array([stamp]))[0])

    def poses_at(self, stamps: FloatArray) -> FloatArray:
        """Return x, y [m] and yaw [rad] (n, 3) of the true poses at ``stamps`` (n,) [s]."""
        return self._world.base_poses(stamps)

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets, as the scene declares them."""
        return tuple(self._scene.targets)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was repaired or guessed of the scene, in sentences."""
        return self._scene.notes

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return points (n, 3) on the targets about ``spacing`` apart [m], and normals (n, 3).

        All faces, visible or not, except those on the floor.

        Args:
            spacing: Distance of neighbouring points [m].
            targets: Names of the targets; None for all.
        """
        chosen = self.targets if targets is None else targets
        wanted = {name for target in chosen for name in self._scene.targets[target]}
        data = self._scene_data()
        points, normals = [], []
        for name in (name for name in self._scene.target_geoms if name in wanted):
            geom = data.geom(name)
            local, directions = sample_geom(
                self._scene.model, geom.id, spacing, self._scene.facings.get(name)
            )
            rotation = geom.xmat.reshape(3, 3)
            points.append(local @ rotation.T + geom.xpos)
            normals.append(directions @ rotation.T)
        p, n = np.concatenate(points), np.concatenate(normals)
        keep = (p[:, 2] > MIN_FACE_HEIGHT) | (n[:, 2] > -0.9)
        return p[keep], n[keep]

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Return noise-free distances (n,) [m] along rays, without the robot; inf for a miss.

        Args:
            origins: (n, 3) [m].
            directions: Unit vectors (n, 3).
        """
        return self._caster.cast(self._world.scene_qpos(), origins, directions).distances

    def first_opaque_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Return what ``first_hits`` does, through what is transparent."""
        if self._panes is None:
            return self.first_hits(origins, directions)
        return self._panes.first_opaque_hits(self._world.scene_qpos(), origins, directions)

    def evidence(self) -> Evidence | None:
        """Return the ground truth of the last scan line read; None before the first."""
        return self._evidence()

    def locate(self, name: str) -> tuple[float, float]:
        """Return the centre (x, y) [m] of the target ``name`` in the odometry frame.

        Raises:
            UnknownNameError: There is no such target.
        """
        if name not in self._scene.targets:
            raise UnknownNameError("target", name, self._scene.targets)
        data = self._scene_data()
        boxes = []
        for part in self._scene.targets[name]:
            geom = data.geom(part)
            local = bounding_points(self._scene.model, geom.id)
            boxes.append(local @ geom.xmat.reshape(3, 3).T + geom.xpos)
        extent = np.concatenate(boxes)
        x, y = ((extent.min(axis=0) + extent.max(axis=0)) / 2)[:2]
        odom = self._T_map_odom.inverse() @ Pose2(x, y)
        return odom.x, odom.y

    def locate_shown(self, name: str) -> tuple[float, float]:
        """Return the place (x, y) [m] in the odometry frame by which a panorama knows ``name``.

        Of what the lidar sees of that target from the start it is nearest to the centre, which may
        itself lie deep inside; the centre, if it sees nothing of it.

        Raises:
            UnknownNameError: There is no such target.
        """
        centre = self.locate(name)
        points, _ = self.surface(SHOWN_SPACING, [name])
        start = self._T_map_odom
        rays = points - (start.x, start.y, LIDAR_HEIGHT)
        lengths = np.linalg.norm(rays, axis=1)
        origins = np.tile((start.x, start.y, LIDAR_HEIGHT), (len(rays), 1))
        distances = self.first_opaque_hits(origins, rays / lengths[:, None])
        places = start.inverse().apply(points[np.abs(distances - lengths) <= AT_SURFACE, :2])
        if len(places) == 0:
            return centre
        x, y = places[np.argmin(np.linalg.norm(places - centre, axis=1))]
        return float(x), float(y)

    def _scene_data(self) -> mujoco.MjData:
        """Return the present state of the scene, without the robot."""
        data = mujoco.MjData(self._scene.model)
        data.qpos[:] = self._world.scene_qpos()
        mujoco.mj_forward(self._scene.model, data)
        return data
