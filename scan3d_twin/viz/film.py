"""A film of a run, made from its recording: the robot drives, the cloud grows, errors appear.

Every frame is put together from the scene as it is without the robot, drawn once, the robot drawn
into a small window, and the points read so far, hidden where the scene is in front of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scan3d_twin.core.png import Picture
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.recording.colours import view_colour, view_colours_rgb
from scan3d_twin.recording.load import RecordedRun, read_track
from scan3d_twin.run.report import count_views
from scan3d_twin.run.resolve import load_run_scene
from scan3d_twin.run.settings import REAL_SCENE
from scan3d_twin.sim.config import RobotErrorConfig
from scan3d_twin.sim.scenes.pictures import Eye, Painter, choose_eye, cut_away, hide
from scan3d_twin.sim.scenes.scene import Scene, scene_from_spec
from scan3d_twin.sim.world import PREFIX, RobotErrors
from scan3d_twin.sim.world import build_model as build_physics
from scan3d_twin.viz.cloud import is_off_target
from scan3d_twin.viz.timeline import Timeline
from scan3d_twin.viz.true_scene import lay_on_scene
from scan3d_twin.viz.view_errors import read_view_errors

WIDTH, HEIGHT, STRIP = 960, 540, 132
"""Size of the picture, and height of the strip with the errors below it [pixels]; both together are
a multiple of 32, without which libx264 (PyAV 18.1) once in 30 times made other bytes of a film."""
ROBOT_SPAN = 0.45
"""Width of the box around the robot that is drawn anew in each frame [m]."""
POINT_TOLERANCE = 0.05
"""Distance behind a surface of the scene within which a point is drawn [m]: several errors."""
BACKGROUND = (201, 209, 217)
"""Colour of points off the target."""
_EMPTY = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="20 20 .1" rgba=".62 .64 .66 1"/>
  <geom name="target" type="box" size=".01 .01 .01" pos="-15 0 .01" rgba=".62 .64 .66 1"/>
  <site name="spawn"/>
</worldbody></mujoco>"""
"""The surroundings of a real robot: a floor, and a target too far away to be seen."""


@dataclass(frozen=True, eq=False)
class Film:
    """What the frames are made of.

    Attributes:
        end: Time of the last frame on the robot's clock [s].
        eye: Where it is seen from.
        scene: The picture without the robot (HEIGHT, WIDTH, 3).
        depth: Distance ahead of each of its pixels (HEIGHT, WIDTH) [m].
        painter: Draws the robot in the scene.
        qpos: Positions of all that moves, without the robot's place (nq,).
        place: Where the robot's own place begins in ``qpos``.
        track: Time, x, y, yaw of the robot in ``map`` (n, 4).
        points: Points in ``map`` by time (n, 3) [m].
        stamps: When each was read (n,) [s].
        colours: Their colours (n, 3), 0..255.
        errors: Time, predicted and realised error [mm] of each view but the first; NaN if unknown.
        epsilon: The wanted error [mm].
        title: One line.
    """

    end: float
    eye: Eye
    scene: Picture
    depth: FloatArray
    painter: Painter
    qpos: FloatArray
    place: int
    track: FloatArray
    points: FloatArray
    stamps: FloatArray
    colours: FloatArray
    errors: FloatArray
    epsilon: float
    title: str


def prepare_film(run: RecordedRun) -> Film:
    """Return what the film of ``run`` is made of.

    Raises:
        SceneError: The scene of a simulated run is gone, or cannot be built.
    """
    # Build the scene with the robot
    session, settings = run.session, run.settings
    real = settings.run.scene == REAL_SCENE
    scene = _empty_scene() if real else load_run_scene(settings.run)
    errors = RobotErrors.draw(RobotErrorConfig(), np.random.default_rng(0))
    model = build_physics(scene, settings.twin.robot, errors)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    # Place the run in it
    T_map_world = Pose2() if real else lay_on_scene(session, scene)
    timeline = Timeline.of(session, read_track(run.path))
    x_y, yaw = timeline.poses[:, :2], timeline.poses[:, 2]
    placed = np.column_stack([T_map_world.apply(x_y), yaw + T_map_world.yaw])
    points, stamps, colours = _points_by_time(session, T_map_world)

    # Draw the scene without the robot
    way = np.column_stack([placed[:, :2], np.zeros(len(placed))])
    eye = _eye_of(points, way) if real else choose_eye(scene)
    cut_away(model, data, eye)
    bare = build_physics(scene, settings.twin.robot, errors)
    bare.geom_rgba[:], bare.geom_matid[:] = model.geom_rgba, model.geom_matid
    for geom, body in enumerate(bare.geom_bodyid):
        if bare.body(body).name.startswith(PREFIX):
            hide(bare, geom)
    picture, depth = Painter(bare).draw(data.qpos, eye, WIDTH, HEIGHT)
    base = model.body(PREFIX + "base").jntadr[0]
    return Film(
        end=timeline.end, eye=eye, scene=picture, depth=depth, painter=Painter(model),
        qpos=data.qpos.copy(), place=int(model.jnt_qposadr[base]),
        track=np.column_stack([timeline.stamps, placed]), points=points, stamps=stamps,
        colours=colours, errors=_errors(run), epsilon=1e3 * session.config.planning.epsilon,
        title=f"{run.name}: {count_views({'views': len(session.views)})}",
    )  # fmt: skip


def draw_frames(film: Film, count: int) -> Iterator[Picture]:
    """Yield ``count`` frames (HEIGHT + STRIP, WIDTH, 3), evenly over the run."""
    canvas, depth = film.scene.copy(), film.depth.copy()
    shown = 0
    for stamp in np.linspace(film.end / count, film.end, count):
        # Add the points read since the last frame
        until = int(np.searchsorted(film.stamps, stamp, side="right"))
        _splat(canvas, depth, film, slice(shown, until))
        shown = until

        # Add the robot and the strip
        frame = canvas.copy()
        _draw_robot(frame, depth, film, stamp)
        yield np.vstack([frame, _draw_strip(film, stamp)])


def _splat(canvas: Picture, depth: FloatArray, film: Film, chosen: slice) -> None:
    """Draw points into ``canvas`` where nothing of ``depth`` is in front of them, and update it."""
    column, row, ahead = film.eye.project(film.points[chosen], WIDTH, HEIGHT)
    order = np.argsort(-ahead)
    column, row = np.floor(column[order]).astype(int), np.floor(row[order]).astype(int)
    ahead, colours = ahead[order], film.colours[chosen][order]
    for down in (0, 1):
        for across in (0, 1):
            r, c = row + down, column + across
            inside = (ahead > 0.1) & (r >= 0) & (r < HEIGHT) & (c >= 0) & (c < WIDTH)
            r, c, near, rgb = r[inside], c[inside], ahead[inside], colours[inside]
            seen = near < depth[r, c] + POINT_TOLERANCE
            canvas[r[seen], c[seen]] = rgb[seen]
            depth[r[seen], c[seen]] = np.minimum(depth[r[seen], c[seen]], near[seen])


def _draw_robot(frame: Picture, depth: FloatArray, film: Film, stamp: float) -> None:
    """Draw the robot at ``stamp`` [s] into ``frame``, in front of what is behind it."""
    # Stand it where it was
    x, y, yaw = (np.interp(stamp, film.track[:, 0], film.track[:, i]) for i in (1, 2, 3))
    qpos = film.qpos.copy()
    qpos[film.place : film.place + 2] = x, y
    qpos[film.place + 3 : film.place + 7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)

    # Find the window around it
    half = ROBOT_SPAN / 2
    corners = np.array(
        [[x + a * half, y + b * half, h] for a in (-1, 1) for b in (-1, 1) for h in (0.0, half)]
    )
    column, row, ahead = film.eye.project(corners, WIDTH, HEIGHT)
    if ahead.min() < 0.1:
        return
    rows = slice(max(0, int(row.min())), min(HEIGHT, int(row.max()) + 1))
    columns = slice(max(0, int(column.min())), min(WIDTH, int(column.max()) + 1))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return

    # Draw it, and what it hides and shades
    picture, near = film.painter.draw(qpos, film.eye, WIDTH, HEIGHT, (rows, columns))
    changed = (near < depth[rows, columns] - 1e-3) | (
        (np.abs(near - film.depth[rows, columns]) < 1e-3)
        & (film.depth[rows, columns] <= depth[rows, columns])
    )
    frame[rows, columns][changed] = picture[changed]


def _draw_strip(film: Film, stamp: float) -> Picture:
    """Return the strip (STRIP, WIDTH, 3) below the picture: the clock and the errors so far."""
    image = Image.new("RGB", (WIDTH, STRIP), (255, 255, 255))
    draw = ImageDraw.Draw(image)
    large, small = ImageFont.load_default(18), ImageFont.load_default(14)
    ink, soft, limit = (31, 35, 40), (87, 96, 106), (179, 89, 0)
    taken = int(np.searchsorted(film.stamps, stamp, side="right"))
    draw.text((18, 16), film.title, ink, large)
    draw.text((18, 48), f"{stamp:.0f} s on the robot's clock", soft, small)
    draw.text((18, 70), f"{taken:,} readings".replace(",", " "), soft, small)
    known = np.isfinite(film.errors[:, 2]).any()
    words = "filled: realised, ring: predicted error" if known else "ring: predicted error"
    draw.text((18, 92), words if len(film.errors) else "", soft, small)

    # Draw the scale: up to twice epsilon
    left, right, bottom, top = 380, WIDTH - 90, STRIP - 18, 14
    middle = (bottom + top) // 2
    draw.line([(left, bottom), (right, bottom)], soft)
    for k in range(left, right, 12):
        draw.line([(k, middle), (k + 6, middle)], limit)
    draw.text((right + 8, middle - 8), f"{film.epsilon:g} mm", limit, small)

    # Draw each view's errors
    for k, (when, predicted, realised) in enumerate(film.errors, start=1):
        if when > stamp:
            break
        x = left + 24 + (right - left - 48) * (k - 1) / max(1, len(film.errors) - 1)
        colour = view_colour(k)
        for value, filled in ((predicted, None), (realised, colour)):
            if math.isfinite(value):
                y = max(top, bottom - (bottom - top) * value / (2.0 * film.epsilon))
                draw.ellipse([x - 5, y - 5, x + 5, y + 5], filled, colour, 2)
        draw.text((x - 4, bottom + 2), f"{k}", soft, small)
    return np.asarray(image)


def _empty_scene() -> Scene:
    return scene_from_spec("empty", mujoco.MjSpec.from_string(_EMPTY), "empty")


def _points_by_time(
    session: Session, T_map_world: Pose2
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return all readings (n, 3) in ``map``, their stamps (n,) and colours (n, 3), by time."""
    points, stamps, colours = [], [], []
    for k, view in enumerate(session.views):
        T = T_map_world @ view.T_world_scan
        lines = view.observation.image.stamps
        for cloud, rgb in (
            (view.sweep.select(is_off_target(view)), np.array(BACKGROUND)),
            (view.target, view_colours_rgb(np.array([k]))[0]),
        ):
            points.append(T.apply(cloud.points))
            stamps.append(lines[cloud.lines] + view.image.spec.beam_times[cloud.beams])
            colours.append(np.broadcast_to(rgb, (len(cloud), 3)))
    order = np.argsort(np.concatenate(stamps), kind="stable")
    joined: tuple[Any, ...] = points, stamps, colours
    p, s, c = (np.concatenate(each)[order] for each in joined)
    return p, s, c


def _errors(run: RecordedRun) -> FloatArray:
    """Return time [s], predicted and realised error [mm] of each view but the first (n, 3)."""
    rows = [
        (float(run.session.views[each.view].observation.image.stamps.max()), each.predicted,
         each.realised)
        for each in read_view_errors(run)
    ]  # fmt: skip
    return np.array(rows).reshape(-1, 3)


def _eye_of(points: FloatArray, way: FloatArray) -> Eye:
    """Return an eye that sees ``points`` (n, 3) and all of the ``way`` (m, 3) from above, aside."""
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    low, high = np.minimum(low, way.min(axis=0)), np.maximum(high, way.max(axis=0))
    looks_at = (low + high) / 2 * (1.0, 1.0, 0.5)
    return Eye(looks_at + 0.9 * float((high - low).max()) * np.array([-0.7, -0.35, 0.62]), looks_at)
