"""Pictures of a scene by ray casting: the same bytes on every computer, without OpenGL."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import batch

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.png import Picture, encode_png
from scan3d_twin.core.types import FloatArray, IntArray
from scan3d_twin.devices.registry import DEFAULT_BASE
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.scenes.surface_samples import bounding_points
from scan3d_twin.sim.scenes.visibility import drawn_rgba, find_seen_geoms
from scan3d_twin.sim.world import PREFIX, RobotErrors, build_model

WIDTH, HEIGHT = 960, 540
FIELD_OF_VIEW = math.radians(45.0)
"""Vertical field of view [rad]."""
CUT_AWAY_SHARE = 0.7
"""Geoms that hide a place within this share of the distance from the eye are cut away."""
SUN = np.array([-0.25, 0.2, 0.95])
"""Direction to the sun, about a unit vector: from above, to the side."""
AMBIENT, HEADLIGHT, SUNLIGHT = 0.45, 0.22, 0.48
"""Shares of the light from all sides, from the eye and from the sun."""
SKY_LOW, SKY_HIGH = (226, 232, 238), (176, 196, 216)
"""Colours of the sky at the horizon and far above it."""
SHADOW_OFFSET = 1e-4
"""Distance from the surface at which the way to the sun begins [m]."""


Window = tuple[slice, slice]
"""Rows and columns of a part of a picture."""


@dataclass(frozen=True)
class Eye:
    """A place to look from.

    Attributes:
        place: Where it is (3,) [m].
        looks_at: What is in the middle of the picture (3,) [m].
    """

    place: FloatArray
    looks_at: FloatArray

    def axes(self) -> FloatArray:
        """Return the unit vectors to the right, up and ahead, as rows (3, 3)."""
        ahead = self.looks_at - self.place
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(right, ahead), ahead])

    def rays(self, width: int, height: int) -> FloatArray:
        """Return the unit vector through each pixel (height * width, 3), from the upper row on."""
        half = math.tan(FIELD_OF_VIEW / 2)
        x = (np.arange(width) + 0.5 - width / 2) / (height / 2) * half
        y = (height / 2 - np.arange(height) - 0.5) / (height / 2) * half
        columns, rows = np.meshgrid(x, y)
        local = np.stack([columns.ravel(), rows.ravel(), np.ones(width * height)], axis=1)
        rays = local @ self.axes()
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(
        self, points: FloatArray, width: int, height: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return column, row and distance ahead [m] (n,) of ``points`` (n, 3) in a picture."""
        right, up, ahead = self.axes()
        offset = points - self.place
        x, y, depth = offset @ right, offset @ up, offset @ ahead
        scale = height / 2 / math.tan(FIELD_OF_VIEW / 2) / np.maximum(depth, 1e-6)
        return width / 2 + scale * x, height / 2 - scale * y, depth


class Painter:
    """Draws a model from any eye, as it stands."""

    def __init__(self, model: Any) -> None:
        """Draw ``model``, of which what a lidar does not see is made invisible."""
        for geom in np.flatnonzero(~find_seen_geoms(model)):
            hide(model, int(geom))
        self._colours = _colours(model)
        self._batch = batch.Batch(model, nsim=1, nthread=1)
        self._qpos = self._batch.bind("qpos")

    def draw(
        self,
        qpos: FloatArray,
        eye: Eye,
        width: int = WIDTH,
        height: int = HEIGHT,
        window: Window | None = None,
    ) -> tuple[Picture, FloatArray]:
        """Return a picture (height, width, 3), and how far ahead a pixel is (height, width) [m].

        Args:
            qpos: Positions of all that moves (nq,).
            eye: Where to look from.
            width: Columns.
            height: Rows.
            window: The part of the picture to draw; None for all of it.
        """
        # Find what each pixel shows
        self._qpos[0] = qpos
        rows, columns = (slice(0, height), slice(0, width)) if window is None else window
        rays = eye.rays(width, height).reshape(height, width, 3)[rows, columns]
        shape, rays = rays.shape[:2], rays.reshape(-1, 3)
        origins = np.broadcast_to(eye.place, rays.shape).copy()
        distances, normals, geoms = self._cast(origins, rays)
        hit = np.flatnonzero(geoms >= 0)
        facing = -np.sum(normals[hit] * rays[hit], axis=1)
        normals[hit] *= np.sign(facing)[:, None]

        # Light it: from all sides, from the eye, and from the sun where nothing is in between
        places = origins[hit] + distances[hit, None] * rays[hit]
        sun = np.broadcast_to(SUN / np.linalg.norm(SUN), places.shape).copy()
        _, _, between = self._cast(places + SHADOW_OFFSET * normals[hit], sun)
        direct = np.where(between < 0, np.maximum(0.0, np.sum(normals[hit] * sun, axis=1)), 0.0)
        light = AMBIENT + HEADLIGHT * np.abs(facing) + SUNLIGHT * direct

        # Paint sky and surfaces
        share = np.clip(rays[:, 2:], 0.0, 1.0)
        colours = (1.0 - share) * SKY_LOW + share * SKY_HIGH
        colours[hit] = 255.0 * self._colours[geoms[hit]] * light[:, None]
        ahead = np.where(geoms >= 0, distances * (rays @ eye.axes()[2]), np.inf)
        picture = np.round(np.clip(colours, 0.0, 255.0)).astype(np.uint8)
        return picture.reshape(*shape, 3), ahead.reshape(shape)

    def _cast(
        self, origins: FloatArray, rays: FloatArray
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return distance (n,) [m], unit normal (n, 3) and geom (n,) of first hits; -1: none."""
        distances, geoms, normals = self._batch.ray(origins, rays, normal=True)
        return distances[0].copy(), normals[0].copy(), geoms[0].astype(np.int64)


def hide(model: Any, geom: int) -> None:
    """Make a geom of ``model`` invisible, to rays as well."""
    model.geom_matid[geom] = -1
    model.geom_rgba[geom] = 0


def _colours(model: Any) -> FloatArray:
    """Return the colour of each geom (n, 3), 0..1; of a texture, its mean."""
    colours = np.array([drawn_rgba(model, geom)[:3] for geom in range(model.ngeom)])
    for geom in np.flatnonzero(model.geom_matid >= 0):
        colours[geom] *= _texture_colour(model, model.geom_matid[geom])
    return colours.reshape(-1, 3)


def _texture_colour(model: Any, material: int) -> FloatArray:
    """Return the mean colour (3,) of the material's texture, 0..1; white without one."""
    texture = model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]
    if texture < 0 or model.tex_nchannel[texture] < 3:
        return np.ones(3)
    channels = int(model.tex_nchannel[texture])
    count = int(model.tex_height[texture] * model.tex_width[texture]) * channels
    first = int(model.tex_adr[texture])
    pixels = model.tex_data[first : first + count].reshape(-1, channels)
    return np.asarray(pixels[:, :3].mean(axis=0) / 255.0)


def render_scene(scene: Scene, robot: str = DEFAULT_BASE) -> Picture:
    """Return a picture (HEIGHT, WIDTH, 3) of ``scene`` with the robot at its start."""
    errors = RobotErrors.draw(RobotErrorConfig(), np.random.default_rng(0))
    model = build_model(scene, robot, errors)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eye = choose_eye(scene)
    cut_away(model, data, eye)
    return Painter(model).draw(data.qpos, eye)[0]


def write_png(path: Path, picture: Picture) -> None:
    """Write ``picture`` (height, width, 3) to ``path``.

    Raises:
        FileError: It cannot be written.
    """
    try:
        path.write_bytes(encode_png(picture))
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror}") from error


def cut_away(model: Any, data: Any, eye: Eye) -> None:
    """Hide geoms between ``eye`` and the robot and target, such as a wall of the room."""
    geom, robot = np.zeros(1, np.int32), data.body(PREFIX + "base").xpos
    for place in (eye.looks_at, robot + np.array([0, 0, 0.2]), 2 * eye.looks_at - robot):
        distance = float(np.linalg.norm(place - eye.place))
        ray = (place - eye.place) / distance
        for _ in range(model.ngeom):
            reach = mujoco.mj_ray(model, data, eye.place, ray, None, 1, -1, geom, None)
            if not 0 <= reach < CUT_AWAY_SHARE * distance:
                break
            hide(model, int(geom[0]))


def choose_eye(scene: Scene) -> Eye:
    """Return an eye that looks over the robot's shoulder at the target."""
    # Bound the target
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    points = []
    for name in scene.target_geoms:
        geom = data.geom(name)
        points.append(bounding_points(scene.model, geom.id) @ geom.xmat.reshape(3, 3).T + geom.xpos)
    seen = np.concatenate(points)

    # Look over the robot's shoulder
    centre = (seen.min(axis=0) + seen.max(axis=0)) / 2
    robot = np.array([scene.spawn.x, scene.spawn.y, 0.2])
    looks_at = 0.6 * centre + 0.4 * robot
    towards = centre[:2] - robot[:2]
    azimuth = math.atan2(towards[1], towards[0]) + math.radians(35.0)
    flat, height = math.cos(math.radians(32.0)), math.sin(math.radians(32.0))
    back = np.array([-flat * math.cos(azimuth), -flat * math.sin(azimuth), height])

    # Back off until both fit
    extent = max(float(np.linalg.norm(towards)), float(np.ptp(seen, axis=0).max()) / 2)
    return Eye(looks_at + (1.2 + 1.05 * extent) * back, looks_at)
