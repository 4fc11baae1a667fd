"""Pictures of a scene, rendered without a screen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.png import Picture, encode_png
from scan3d_twin.devices.registry import DEFAULT_BASE
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.scenes.offscreen import open_context
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.scenes.surface_samples import bounding_points
from scan3d_twin.sim.world import PREFIX, RobotErrors, build_model

WIDTH, HEIGHT = 1280, 720
HIDDEN_GROUP = 3
"""First group of the geoms and sites that pictures do not show."""
CUT_AWAY_SHARE = 0.7
"""Geoms that hide a place within this share of the distance from the camera are cut away."""
SUPERSAMPLES = 4
SHADOW_MAP_SIZE = 2048
"""Side of the shadow map [pixels]; MuJoCo's default of 4096 takes ten times the time."""


def render_scene(scene: Scene, robot: str = DEFAULT_BASE) -> Picture:
    """Return a picture (height, width, 3) of ``scene`` with the robot at its start.

    Raises:
        ConfigError: No OpenGL backend works; the message names what to install.
    """
    # Set the quality of the picture
    errors = RobotErrors.draw(RobotErrorConfig(), np.random.default_rng(0))
    spec = scene.spec.copy()
    spec.visual.quality.shadowsize = SHADOW_MAP_SIZE
    spec.visual.quality.offsamples = SUPERSAMPLES
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.5] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT

    # Build the model with the robot
    model = build_model(replace(scene, spec=spec), robot, errors)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    # Draw it off screen
    camera = _camera(scene)
    _cut_away(model, data, camera)
    context = open_context(WIDTH, HEIGHT)
    try:
        context.make_current()
        return _draw(model, data, camera)
    finally:
        context.free()


def _draw(model: Any, data: Any, camera: Any) -> Picture:
    # Hide the helper groups
    option = mujoco.MjvOption()
    option.geomgroup[HIDDEN_GROUP:] = 0
    option.sitegroup[HIDDEN_GROUP:] = 0

    # Prepare scene and context
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 100)
    painter = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
    mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, painter)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(model, data, option, mujoco.MjvPerturb(), camera, everything, scene)

    # Render and read back
    window = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
    mujoco.mjr_render(window, scene, painter)
    picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    mujoco.mjr_readPixels(picture, None, window, painter)
    painter.free()
    return picture[::-1]  # OpenGL counts rows from below


def write_png(path: Path, picture: Picture) -> None:
    """Write ``picture`` (height, width, 3) to ``path``.

    Raises:
        FileError: It cannot be written.
    """
    try:
        path.write_bytes(encode_png(picture))
    except OSError as error:
        raise FileError(f"cannot write {path}: {error.strerror}") from error


def _cut_away(model: Any, data: Any, camera: Any) -> None:
    """Hide geoms between ``camera`` and the robot and target, such as a wall of the room."""
    # Compute the camera's eye
    azimuth, elevation = np.radians(camera.azimuth), np.radians(camera.elevation)
    flat = np.cos(elevation)
    ahead = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    eye = camera.lookat - camera.distance * ahead

    # Hide the geoms in between
    geom, robot = np.zeros(1, np.int32), data.body(PREFIX + "base").xpos
    for place in (camera.lookat, robot + np.array([0, 0, 0.2]), 2 * camera.lookat - robot):
        ray = (place - eye) / np.linalg.norm(place - eye)
        for _ in range(model.ngeom):
            reach = mujoco.mj_ray(model, data, eye, ray, None, 1, -1, geom, None)
            if not 0 <= reach < CUT_AWAY_SHARE * float(np.linalg.norm(place - eye)):
                break
            model.geom_matid[geom[0]] = -1
            model.geom_rgba[geom[0]] = 0


def _camera(scene: Scene) -> Any:
    """Return a camera that looks over the robot's shoulder at the target."""
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
    camera = mujoco.MjvCamera()
    camera.lookat = 0.6 * centre + 0.4 * robot
    towards = centre[:2] - robot[:2]
    camera.azimuth = float(np.degrees(np.arctan2(towards[1], towards[0]))) + 35.0
    camera.elevation = -32.0

    # Back off until both fit
    extent = max(float(np.linalg.norm(towards)), float(np.ptp(seen, axis=0).max()) / 2)
    camera.distance = 1.2 + 1.05 * extent
    return camera
