"""The 3D content of a run on a viser server: views in their colours, robot, scan line, plan.

Viser provides the page, the mouse and the network; this module adds the content. The page loads
nothing from other machines.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import viser

from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.core.model.fused_cloud import thin_by_voxel
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import Candidate, FloatArray, Plan, Pose2, Scan3D
from scan3d_twin.recording.colours import view_colours_rgb
from scan3d_twin.viz.cloud import (
    FIELD_OF_VIEW,
    STILL_HEIGHT,
    STILL_WIDTH,
    choose_camera,
    is_off_target,
    points_off_target,
)
from scan3d_twin.viz.served.point_colours import Colouring, colour_points
from scan3d_twin.viz.served.server import set_theme

MAX_VIEW_POINTS = 25_000
"""Most points shown of a view: ten views stay fast on a phone."""
BACKGROUND_VOXEL = 0.05
"""Side of the voxels to which points off the target are thinned [m]."""
POINT_SIZE = 0.011
"""Size of a point [m]: the distance between two readings at 1.2 m."""
PATH, PATH_HEIGHT = (124, 94, 180), 0.01
"""Colour of the way driven, and the height at which it is drawn [m]."""
PRECISION: Final = "float32"
"""Precision in which points reach the page: viser's default, float16, has steps of 2 mm from 2 m on
and of 4 mm from 4 m on."""
SAME_PLACE = 1e-3
"""Distance within which a page's camera, in single precision, stands where it was sent [m]."""
GREY, DARK, RED, CHOSEN = (150, 158, 168), (60, 66, 74), (235, 50, 50), (11, 98, 196)
ORANGE, PALE, CELL, SECTION = (230, 120, 20), (190, 196, 204), (222, 226, 231), (196, 203, 211)


class Stage:
    """The shown objects, all in frame ``world``.

    Showing an object again moves or replaces it.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._views: list[Any] = []
        self._targets: dict[int, tuple[Any, FloatArray]] = {}
        self._backgrounds: dict[int, Any] = {}
        self._sizes: dict[int, int] = {}
        self._plan: list[Any] = []
        self._line: Any = None
        self._sweep: Any = None
        self._path: Any = None
        self._truth: Any = None
        self._upto, self._with_background, self._with_path = 0, True, True
        self._colouring: Colouring = "view"
        self._heights = (math.inf, -math.inf)
        self._aim: tuple[FloatArray, FloatArray] | None = None
        # A page that connects meanwhile is no client yet, and has taken the camera of before.
        server.on_client_connect(self._meet_page)
        server.scene.set_up_direction("+z")
        server.scene.add_grid("/floor", 12.0, 12.0, cell_color=CELL, section_color=SECTION)
        self._robot = self._build_robot()

    def _build_robot(self) -> Any:
        scene = self._server.scene
        frame = scene.add_frame("/robot", show_axes=False)
        scene.add_cylinder("/robot/body", 0.17, 0.09, DARK, position=(0.0, 0.0, 0.06))
        scene.add_cylinder("/robot/mast", 0.012, 0.2, GREY, position=(0.05, 0.0, 0.19))
        lidar, nose = (0.05, 0.05, 0.07), (0.05, 0.02, 0.02)
        scene.add_box("/robot/lidar", ORANGE, dimensions=lidar, position=(0.05, 0.0, 0.3))
        scene.add_box("/robot/nose", ORANGE, dimensions=nose, position=(0.16, 0.0, 0.08))
        return frame

    def show_robot(self, T_world_base: Pose2) -> None:
        """Show the robot at its pose."""
        self._robot.position = (T_world_base.x, T_world_base.y, 0.0)
        self._robot.wxyz = _turn(T_world_base)

    def show_line(self, points: FloatArray) -> None:
        """Show the latest scan line by its points (n, 3) in ``world`` [m]."""
        if len(points) == 0:
            return
        if self._line is not None:
            self._line.points, self._line.visible = points.astype(np.float32), True
            return
        self._line = self._server.scene.add_point_cloud(
            "/line",
            points.astype(np.float32),
            RED,
            point_size=1.6 * POINT_SIZE,
            precision=PRECISION,
        )

    def hide_line(self) -> None:
        """Hide the scan line at the end of the run."""
        if self._line is not None:
            self._line.visible = False

    def show_views(self, session: Session) -> None:
        """Show all views of ``session``; those shown before move, and show more of the target."""
        for index, view in enumerate(session.views):
            if index == len(self._views):
                self._add_view(index, view)
            elif len(view.target) != self._sizes[index]:
                self._show_points(index, view)
            self._views[index].position = (view.T_world_scan.x, view.T_world_scan.y, 0.0)
            self._views[index].wxyz = _turn(view.T_world_scan)
        self._upto = len(session.views)
        self._show()

    def _add_view(self, index: int, view: View) -> None:
        """Add the points of a view below a frame that is its frame ``scan``."""
        # Add the frame and what is in it
        scene, name = self._server.scene, f"/views/{index:03d}"
        self._views.append(scene.add_frame(name, show_axes=False))
        self._show_points(index, view)

        # Add the viewpoint's number
        place, colour = (0.0, 0.0, LIDAR_HEIGHT), view_colours_rgb(np.array([index]))[0]
        scene.add_icosphere(f"{name}/place", 0.03, colour, subdivisions=2, position=place)
        scene.add_label(f"{name}/number", f"{index}", position=(0.0, 0.0, LIDAR_HEIGHT + 0.06))

    def _show_points(self, index: int, view: View) -> None:
        """Show the points of a view, on the target and off it, in place of any shown before."""
        # Show the thinned target
        name, target = f"/views/{index:03d}", thin_target(view)
        self._widen_heights(target)
        cloud = self._cloud(f"{name}/target", target, self._colours(target, index), POINT_SIZE)
        self._targets[index], self._sizes[index] = (cloud, target), len(view.target)

        # Show the thinned background
        around = thin_by_voxel(points_off_target(view), BACKGROUND_VOXEL)
        self._backgrounds[index] = self._cloud(f"{name}/background", around, PALE, 0.6 * POINT_SIZE)

    def _cloud(self, name: str, points: FloatArray, colour: Any, size: float) -> Any:
        """Return a cloud of round points (n, 3) [m] of ``size`` [m]."""
        return self._server.scene.add_point_cloud(
            name,
            points.astype(np.float32),
            colour,
            point_size=size,
            point_shape="circle",
            point_shading="flat",
            precision=PRECISION,
        )

    def show_plan(self, session: Session) -> None:
        """Show the last plan of ``session``: the next viewpoint, and the other candidates."""
        for handle in self._plan:
            handle.remove()
        self._plan = []
        if not session.plans:
            return
        plan = session.plans[-1]
        for k, each in enumerate(plan.candidates):
            if plan.viewpoint is None or each.viewpoint.distance(plan.viewpoint) > 1e-6:
                self._add_candidate(f"/plan/{k:03d}", each)
        if plan.viewpoint is not None:
            self._add_next(plan, plan.viewpoint, session.config.sweep.width)

    def _add_candidate(self, name: str, candidate: Candidate) -> None:
        """Add a candidate viewpoint with its predicted error."""
        scene, pose = self._server.scene, candidate.viewpoint
        place, above = (pose.x, pose.y, LIDAR_HEIGHT), (pose.x, pose.y, LIDAR_HEIGHT + 0.03)
        self._plan.append(scene.add_icosphere(name, 0.02, GREY, subdivisions=2, position=place))
        if math.isfinite(candidate.predicted_rmse):
            words = f"{candidate.overlap:.0%}: {1e3 * candidate.predicted_rmse:.1f} mm"
            self._plan.append(
                scene.add_label(f"{name}-error", words, position=above, font_screen_scale=0.8)
            )

    def _add_next(self, plan: Plan, pose: Pose2, width: float) -> None:
        """Add the chosen viewpoint: a marker, its scan sector and its predicted error."""
        # Outline the scan sector
        scene = self._server.scene
        corners = np.array([[0.0, 0.0], *_sector(width)])
        ring = np.column_stack([pose.apply(corners), np.full(len(corners), 0.02)])
        sides = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1).astype(np.float32)

        # Describe the predicted error
        known = math.isfinite(plan.predicted_rmse)
        error = f"{1e3 * plan.predicted_rmse:.1f} mm" if known else "error unknown"
        place, above = (pose.x, pose.y, LIDAR_HEIGHT), (pose.x, pose.y, LIDAR_HEIGHT + 0.08)
        words = f"next: {plan.overlap:.0%}, {error}"

        # Add the objects
        self._plan += [
            scene.add_line_segments("/next/sector", sides, CHOSEN, thickness=0.012),
            scene.add_icosphere("/next/place", 0.045, CHOSEN, subdivisions=2, position=place),
            scene.add_label("/next/error", words, position=above),
        ]

    def show_upto(self, count: int) -> None:
        """Show the first ``count`` views only."""
        self._upto = count
        self._show()

    def show_background(self, shown: bool) -> None:
        """Show or hide the points off the target."""
        self._with_background = shown
        self._show()

    def _show(self) -> None:
        for index, view in enumerate(self._views):
            view.visible = index < self._upto
            self._backgrounds[index].visible = self._with_background and index < self._upto

    def _widen_heights(self, points: FloatArray) -> None:
        """Extend the colours of the heights to ``points``."""
        if len(points):
            low, high = float(points[:, 2].min()), float(points[:, 2].max())
            self._heights = min(self._heights[0], low), max(self._heights[1], high)
        if self._colouring == "height":
            self._colour()

    def set_colouring(self, colouring: Colouring) -> None:
        """Colour the points of the target by ``colouring``."""
        self._colouring = colouring
        self._colour()

    def _colour(self) -> None:
        for index, (handle, points) in self._targets.items():
            handle.colors = self._colours(points, index)

    def _colours(self, points: FloatArray, index: int) -> npt.NDArray[np.uint8]:
        return colour_points(points, index, self._colouring, self._heights)

    def show_path(self, places: FloatArray) -> None:
        """Show the way driven through the ``places`` (n, 2) in ``world`` [m]."""
        drawn = np.column_stack([places, np.full(len(places), PATH_HEIGHT)])
        sides = np.stack([drawn[:-1], drawn[1:]], axis=1).astype(np.float32)
        if len(sides) == 0:
            if self._path is not None:
                self._path.visible = False
            return
        self._path = self._server.scene.add_line_segments(
            "/path", sides, PATH, thickness=0.012, visible=self._with_path
        )

    def set_path_shown(self, shown: bool) -> None:
        """Show or hide the way driven."""
        self._with_path = shown
        if self._path is not None:
            self._path.visible = shown

    def show_truth(self, triangles: FloatArray) -> None:
        """Show the true surface of ``triangles`` (m, 3, 3) in ``world`` [m]."""
        corners = triangles.reshape(-1, 3).astype(np.float32)
        faces = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        self._truth = self._server.scene.add_mesh_simple(
            "/truth", corners, faces, color=GREY, opacity=0.45, flat_shading=True, side="double"
        )

    def set_truth_shown(self, shown: bool) -> None:
        """Show or hide the true surface."""
        if self._truth is not None:
            self._truth.visible = shown

    def show_sweep(self, session: Session, index: int, lines: int) -> None:
        """Show the first ``lines`` lines of view ``index``, the last one as the scan line."""
        view = session.views[index]
        read = int(np.searchsorted(view.target.lines, lines))
        target = view.target.points[:read][:: _stride(view)]
        around = view.sweep.points[(view.sweep.lines < lines) & is_off_target(view)]
        last = view.sweep.points[view.sweep.lines == lines - 1]
        self._show_part(view.T_world_scan, target, self._colours(target, index), around)
        self.show_line(view.T_world_scan.apply(last))

    def show_panorama(self, T_world_scan: Pose2, panorama: Scan3D, lines: int) -> None:
        """Show the first ``lines`` lines of a ``panorama``, the last one as the scan line."""
        around = panorama.points[panorama.lines < lines]
        self._show_part(T_world_scan, np.zeros((0, 3)), PALE, around)
        self.show_line(T_world_scan.apply(panorama.points[panorama.lines == lines - 1]))

    def _show_part(
        self, T_world_scan: Pose2, target: FloatArray, colours: Any, around: FloatArray
    ) -> None:
        """Show points of the ``target`` and ``around`` it, both in ``scan`` (n, 3) [m]."""
        with self._server.atomic():
            self._sweep = self._server.scene.add_frame("/sweep", show_axes=False)
            self._sweep.position = (T_world_scan.x, T_world_scan.y, 0.0)
            self._sweep.wxyz = _turn(T_world_scan)
            self._cloud("/sweep/target", target, colours, POINT_SIZE)
            thin = thin_by_voxel(around, BACKGROUND_VOXEL)
            off_target = self._cloud("/sweep/background", thin, PALE, 0.6 * POINT_SIZE)
            off_target.visible = self._with_background

    def hide_sweep(self) -> None:
        """Hide the sweep and its scan line."""
        self.hide_line()
        if self._sweep is not None:
            self._sweep.remove()
            self._sweep = None

    def set_dark(self, wanted: bool) -> None:
        """Show the page dark or light."""
        set_theme(self._server, dark=wanted)

    def aim_camera(self, session: Session, client: viser.ClientHandle | None = None) -> None:
        """Point the camera of ``client``, or of all pages, at the target from the robot's side."""
        hint = np.column_stack([session.hint, np.zeros(len(session.hint))])
        seen = [view.T_world_scan.apply(view.target.points) for view in session.views]
        poses = [view.T_world_scan for view in session.views]
        camera = choose_camera(np.concatenate([hint, *seen]), poses)
        a, e, d = camera.azimuth, camera.elevation + math.radians(12.0), 1.1 * camera.distance
        ray = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        self._aim = middle, offset = camera.middle, d * ray
        self._server.initial_camera.look_at = middle
        self._server.initial_camera.position = middle + offset
        for page in self._server.get_clients().values() if client is None else [client]:
            self._aim_page(page)

    def _meet_page(self, page: viser.ClientHandle) -> None:
        """Aim the camera of a new ``page``, and again whenever it returns to the initial camera.

        Viser's page goes there some time after its first message, so that it may undo what it was
        told meanwhile, and when its user chooses "Reset View".
        """
        self._aim_page(page)
        page.camera.on_update(lambda _: self._aim_returned(page))

    def _aim_returned(self, page: viser.ClientHandle) -> None:
        """Aim the camera of ``page`` if it stands at the initial camera."""
        initial, camera = self._server.initial_camera, page.camera
        wanted = [initial.position, initial.look_at]
        if np.allclose([camera.position, camera.look_at], wanted, atol=SAME_PLACE):
            self._aim_page(page)

    def _aim_page(self, page: viser.ClientHandle) -> None:
        """Point the camera of ``page`` at what was aimed at last, if anything."""
        if self._aim is None:
            return
        middle, offset = self._aim
        page.camera.position = middle + _back_off(page.camera) * offset
        page.camera.look_at = middle  # second, as a new position moves it along


def _back_off(camera: viser.CameraHandle) -> float:
    """Return the factor of the distance from which a window higher than wide sees as much."""
    across = math.tan(FIELD_OF_VIEW / 2) * STILL_WIDTH / STILL_HEIGHT
    return max(1.0, across / (math.tan(camera.fov / 2) * camera.aspect))


def thin_target(view: View) -> FloatArray:
    """Return the points of the target of ``view`` that are shown (n, 3) in ``scan`` [m]."""
    return view.target.points[:: _stride(view)]


def _stride(view: View) -> int:
    """Return every which point of the target of ``view`` is shown."""
    return max(1, math.ceil(len(view.target.points) / MAX_VIEW_POINTS))


def _sector(width: float) -> FloatArray:
    """Return the arc of a sweep, of radius 0.35 m (n, 2) in ``scan`` [m]."""
    angles = np.linspace(width / 2, -width / 2, 9)
    return 0.35 * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _turn(pose: Pose2) -> tuple[float, float, float, float]:
    return (math.cos(pose.yaw / 2), 0.0, 0.0, math.sin(pose.yaw / 2))
