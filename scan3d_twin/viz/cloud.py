"""The camera and the light of a model, and its still picture for browsers without WebGL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.model.fused_cloud import Model, thin_by_voxel
from scan3d_twin.core.png import encode_png
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2
from scan3d_twin.recording.colours import view_colours_rgb

MAX_SURROUNDING_POINTS = 60_000
SURROUNDINGS_VOXEL = 0.03
"""Side of the voxels to which the surroundings are thinned [m]."""
GREY = "#8b949e"
FIELD_OF_VIEW = math.radians(35.0)
"""Vertical field of view of the camera [rad]."""
STILL_WIDTH, STILL_HEIGHT = 1200, 720


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera that looks at a middle, z up.

    Attributes:
        middle: Middle of the shown points (3,) [m].
        distance: Distance of the camera from the middle [m].
        azimuth: Direction from the middle to the camera [rad].
        elevation: Elevation of the camera above the middle [rad].
    """

    middle: FloatArray
    distance: float
    azimuth: float
    elevation: float


def choose_camera(points: FloatArray, viewpoints: Sequence[Pose2]) -> Camera:
    """Return a camera that sees all ``points`` (n, 3) from the side of most ``viewpoints``."""
    if len(points) == 0:
        return Camera(np.zeros(3), 3.0, math.pi, math.radians(25.0))

    # Look from the viewpoints' side
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    places = np.array([[pose.x, pose.y] for pose in viewpoints]).reshape(-1, 2)
    x, y = (places - middle[:2]).sum(axis=0) if len(places) else (-1.0, 0.0)
    # A little to the side shows depth better than from straight ahead.
    azimuth, elevation = math.atan2(y, x) + math.radians(20.0), math.radians(24.0)

    # Back off until it fits
    camera = Camera(middle, 2.0 * float(np.ptp(points, axis=0).max()), azimuth, elevation)
    for _ in range(3):
        column, row, _ = _project(points, camera)
        filled = max(
            float(np.abs(column / STILL_WIDTH - 0.5).max()),
            float(np.abs(row / STILL_HEIGHT - 0.5).max()),
        )
        camera = replace(camera, distance=camera.distance * filled / 0.46)
    return camera


def surrounding_points(session: Session) -> FloatArray:
    """Return the points of all views off the target, thinned (n, 3) in ``world`` [m]."""
    clouds = [view.T_world_scan.apply(points_off_target(view)) for view in session.views]
    if not clouds:
        return np.zeros((0, 3))
    thin = thin_by_voxel(np.concatenate(clouds), SURROUNDINGS_VOXEL)
    return thin[:: max(1, math.ceil(len(thin) / MAX_SURROUNDING_POINTS))]


def points_off_target(view: View) -> FloatArray:
    """Return the points of ``view`` off its target (n, 3) in ``scan`` [m]."""
    return view.sweep.points[is_off_target(view)]


def is_off_target(view: View) -> BoolArray:
    """Return which points of the sweep of ``view`` are not of its target (n,)."""
    beams = view.image.spec.n_beams
    ours = view.target.lines * beams + view.target.beams
    return ~np.isin(view.sweep.lines * beams + view.sweep.beams, ours)


def shade_normals(normals: FloatArray, camera: Camera) -> FloatArray:
    """Return the brightness (n,) of surfaces with ``normals`` (n, 3), 0..1; 0.7 without a normal.

    The light comes from above, to the left of ``camera``.
    """
    a = camera.azimuth - math.radians(45.0)
    light = np.array([math.cos(a), math.sin(a), 1.0]) / math.sqrt(2.0)
    lit = 0.55 + 0.45 * (normals @ light)
    return np.asarray(np.clip(np.where(np.isfinite(lit), lit, 0.7), 0.0, 1.0))


def render_still(model: Model, camera: Camera) -> bytes:
    """Return a picture of ``model`` from ``camera`` as PNG with a transparent background."""
    # Project, near points last
    size = (STILL_HEIGHT, STILL_WIDTH)
    x, y, depth = _project(model.points, camera)
    front = depth > 0.05
    order = np.flatnonzero(front)[np.argsort(-depth[front])]  # near points overwrite far ones

    # Draw squares of 3 pixels
    picture = np.zeros((*size, 4), np.uint8)
    colours = _colours(model.view, shade_normals(model.normals, camera))[order]
    column, row = np.round(x[order]).astype(np.int64), np.round(y[order]).astype(np.int64)
    for down in range(-1, 2):
        for across in range(-1, 2):
            r, c = row + down, column + across
            inside = (r >= 0) & (r < size[0]) & (c >= 0) & (c < size[1])
            picture[r[inside], c[inside]] = colours[inside]
    return encode_png(picture)


def _project(points: FloatArray, camera: Camera) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return column, row and depth (n,) of ``points`` (n, 3) in the still picture."""
    # Compute the camera's axes
    a, e = camera.azimuth, camera.elevation
    back = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    up = np.cross(back, right)

    # Project in perspective
    offset = points - camera.middle - camera.distance * back
    depth = -offset @ back
    focal = STILL_HEIGHT / 2 / math.tan(FIELD_OF_VIEW / 2)
    scale = focal / np.maximum(depth, 1e-6)
    return (
        STILL_WIDTH / 2 + scale * (offset @ right),
        STILL_HEIGHT / 2 - scale * (offset @ up),
        depth,
    )


def _colours(view: IntArray, light: FloatArray) -> npt.NDArray[np.uint8]:
    """Return the opaque colours (n, 4) of points by view, scaled with the ``light`` (n,)."""
    lit = view_colours_rgb(view) * (0.55 + 0.6 * light[:, None])
    return np.column_stack([np.minimum(lit, 255), np.full(len(view), 255)]).astype(np.uint8)
