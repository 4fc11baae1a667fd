"""The planning context: what planners derive from the latest view, such as termination."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from scan3d_twin.core.navigation.costmap import Costmap, build_costmap
from scan3d_twin.core.planning.surface.surface_prediction import Prediction, predict_surface
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.scanning.smoothing import smooth
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, Plan, Pose2, RangeImage, Scan3D
from scan3d_twin.core.viewpoints import (
    MAX_FRONT_ANGLE,
    NEARLY_ROUND,
    SILHOUETTE_TURN,
    TOWARDS_ROBOT,
    Contour,
    Segment,
    average_lines,
    choose_viewpoint,
    count_well_seen,
    estimate_corner_angle,
    extract_contour,
    find_next_segment,
    find_predicted_segment,
    has_corner_after,
    is_end_in_view,
    iterate_oblique,
    limit_direction,
    measure_angle,
    measure_sweep_width,
    sum_turns,
)

MIN_LINES = 5
"""Smallest number of lines whose direction tells a corner or a further part of the front."""
MIN_TARGET_LINES = 2
"""Smallest number of lines on a target in sight: a pole of 3 cm has three at 1 m. That it is no
stray is up to ``target.min_points``."""
FRONT_ANGLE_TOLERANCE = math.radians(20.0)
"""Distance from ``MAX_FRONT_ANGLE`` within which a view ends a tour of the front [rad]: one more
would show little new."""
CLOSING_DISTANCE = 0.10
"""Distance of the contour's end from its beginning within which it is closed [m]: a few times the
drift of a dozen registered views."""


@dataclass(frozen=True)
class Placement:
    """The viewpoint for one overlap.

    Attributes:
        viewpoint: ``T_scan_next`` in frame ``scan`` of the latest view; None if none is feasible.
        is_wanted: Whether it is the viewpoint of Fig. 8, not an alternative to it.
    """

    viewpoint: Pose2 | None
    is_wanted: bool


@dataclass(frozen=True)
class PlanningContext:
    """The latest view of a session and what planners derive from it, computed on demand."""

    session: Session
    known_costmap: Costmap | None = None
    """The costmap of ``session`` if the caller has it already."""

    @property
    def view(self) -> View:
        """The latest view."""
        return self.session.views[-1]

    @cached_property
    def P(self) -> Scan3D:
        """The paper's P: the target in the latest view, as far as its incidence is not too flat."""
        lines = count_well_seen(self._whole)
        return self._seen if lines == len(self._whole.points) else self._seen.first_lines(lines)

    @cached_property
    def _seen(self) -> Scan3D:
        """The target in the latest view without the sweep's margins, unless it is in them only."""
        target, sweep = self.view.target, self.session.config.sweep
        if sweep.margin == 0.0:
            return target
        yaws = self.view.image.yaws[:, self.view.image.spec.n_beams // 2]
        inside = target.select((np.abs(yaws) <= sweep.width / 2)[target.lines])
        return inside if len(inside.occupied_lines) >= MIN_TARGET_LINES else target

    @cached_property
    def _whole(self) -> Contour:
        """The contour of the target in the latest view without the sweep's margins."""
        return extract_contour(self._seen)

    @cached_property
    def contour(self) -> Contour:
        """The contour of P."""
        return self._whole if self.P is self._seen else extract_contour(self.P)

    @cached_property
    def has_end_in_view(self) -> bool:
        """Whether the target ends with P, or turns around a corner there, on the travel side."""
        view = self.view
        if self._goes_on:
            return False
        if len(self._whole.points) - self.n_lines >= MIN_LINES:
            return has_corner_after(self._whole, self.n_lines)
        return is_end_in_view(view.image, view.sweep, view.target, self.session.config.target)

    @cached_property
    def _goes_on(self) -> bool:
        """Whether the sweep's margin shows more of the target's front on the travel side."""
        beyond = len(self.view.target.occupied_lines) - len(self._seen.occupied_lines)
        if self.session.config.tour != "front" or beyond < MIN_LINES:
            return False
        contour = extract_contour(self.view.target)
        last = int(self._seen.occupied_lines[-1])
        first = int(np.searchsorted(self.view.target.occupied_lines, last))
        if len(contour.points) - first < MIN_LINES:
            return False
        return abs(measure_angle(self._front, contour.normal(first))) < MAX_FRONT_ANGLE

    @cached_property
    def predicted_surface(self) -> Prediction | None:
        """The surface predicted beyond P, if that is wanted and its hold-out error is small."""
        config = self.session.config.planning
        if config.foresight == "none":
            return None
        prediction = predict_surface(average_lines(self.P))
        if prediction is None or prediction.sigma > config.foresight_sigma:
            return None
        return prediction

    @cached_property
    def smoothed(self) -> RangeImage:
        """The latest range image, smoothed."""
        return smooth(self.view.image)

    @cached_property
    def costmap(self) -> Costmap:
        """The costmap with the robot at the latest view."""
        if self.known_costmap is not None:
            return self.known_costmap
        session = self.session
        start = self.view.observation.T_odom_scan
        return build_costmap(
            session.observations(), session.config, start, workspace=session.workspace
        )

    @property
    def has_panorama(self) -> bool:
        """Whether a panorama was taken since the latest view."""
        return any(taken == len(self.session.views) for taken, _ in self.session.panoramas)

    @cached_property
    def n_lines(self) -> int:
        """The paper's n: the number of lines of P."""
        return len(self.P.occupied_lines)

    def n_Q(self, overlap: float) -> int:
        """Return the number of overlapping lines for an overlap eta: eta * n."""
        return max(2, round(overlap * self.n_lines))

    def find_placement(self, overlap: float) -> Placement:
        """Return the viewpoint that sees ``overlap`` of the current lines again (Fig. 8)."""
        segment = self._find_segment(overlap)
        return Placement(*choose_viewpoint(segment, self.session.config, self.is_feasible))

    def find_oblique_viewpoints(self, overlap: float) -> list[Pose2]:
        """Return the feasible viewpoints of ``overlap`` turned off the segment's normal.

        They face the middle of the same segment. In a tour of the front they stay within
        ``MAX_FRONT_ANGLE`` of it.
        """
        segment = self._find_segment(overlap)
        return [
            viewpoint
            for viewpoint in iterate_oblique(segment, self.session.config.planning.standoff)
            if self._is_in_tour(viewpoint) and self.is_feasible(viewpoint)
        ]

    def _find_segment(self, overlap: float) -> Segment:
        """Return the next segment, of which ``overlap`` of the current lines is seen already."""
        # Find it on the predicted surface or the contour
        config = self.session.config
        beyond = self._front if config.tour == "front" else None
        n_Q, S1 = self.n_Q(overlap), measure_sweep_width(config)
        if self.predicted_surface is not None and not self.has_end_in_view:
            segment = find_predicted_segment(self.contour, n_Q, S1, self.predicted_surface.points)
        else:
            segment = find_next_segment(
                self.contour, n_Q, S1, beyond, ends=self.has_end_in_view, bend=self._bend
            )

        # Keep to the front
        if config.tour != "front":
            return segment
        return replace(
            segment, normal=limit_direction(segment.normal, self._front, MAX_FRONT_ANGLE)
        )

    def _is_in_tour(self, viewpoint: Pose2) -> bool:
        """Return whether the tour has ``viewpoint``, given in ``scan``."""
        if self.session.config.tour != "front":
            return True
        back = Pose2(0.0, 0.0, viewpoint.yaw).rotate(TOWARDS_ROBOT)
        return abs(measure_angle(self._front, back)) <= MAX_FRONT_ANGLE + 1e-6

    def is_feasible(self, viewpoint: Pose2) -> bool:
        """Return whether the robot can reach ``viewpoint``, given in ``scan``, and stand there."""
        there = self.view.observation.T_odom_scan @ viewpoint
        return self.costmap.is_feasible(there.x, there.y)

    def termination_reason(self) -> str | None:
        """Return why the tour is finished, or None while there is more to scan."""
        if not self._is_in_sight:
            return "target lost: the latest view shows nothing of it"
        if (reason := explain_view_limit(self.session)) is not None:
            return reason
        if not self.is_contour_done:
            return None
        return "front complete" if self.session.config.tour == "front" else "contour complete"

    @property
    def is_ongoing(self) -> bool:
        """Whether the latest view shows the target and another one may follow."""
        return self._is_in_sight and explain_view_limit(self.session) is None

    @property
    def _is_in_sight(self) -> bool:
        return len(self._seen.occupied_lines) >= MIN_TARGET_LINES

    @cached_property
    def is_contour_done(self) -> bool:
        """Whether the contour was followed to its end, by the latest view or an earlier one."""
        if self._is_in_sight and self._has_ended_contour():
            return True
        earlier = self.session.views[:-1]
        return (
            bool(earlier) and PlanningContext(replace(self.session, views=earlier)).is_contour_done
        )

    def _has_ended_contour(self) -> bool:
        """Return whether the latest view ends the contour."""
        if self.session.config.tour == "front":
            return self._is_beside_front() and self.has_end_in_view
        return self._is_closed()

    @cached_property
    def _bend(self) -> float:
        """Angle by which the surface is expected to bend where it ends in view [rad]."""
        wanted = self.session.config.planning.corner_model
        return estimate_corner_angle(self.contour) if wanted == "contour" else SILHOUETTE_TURN

    @cached_property
    def _front(self) -> FloatArray:
        """Outward unit normal (2,) in ``scan`` of the target's front as the robot first saw it."""
        return self.view.T_world_scan.inverse().rotate(self.session.front)

    def _is_beside_front(self) -> bool:
        """Return whether the latest view already looked at the front from its far side."""
        return measure_angle(self._front, TOWARDS_ROBOT) >= MAX_FRONT_ANGLE - FRONT_ANGLE_TOLERANCE

    def _is_closed(self) -> bool:
        """Return whether a tour all round has come back to where the first view began."""
        views = self.session.views
        turned = sum_turns(view.T_world_scan for view in views)
        if turned < NEARLY_ROUND:
            return False
        if turned >= math.tau:
            return True
        first = views[0].T_world_scan.apply(extract_contour(views[0].target).points)
        end = self.view.T_world_scan.apply(self.contour.points[-1])
        return bool(Tree.of(first).closest(end[None])[0] <= CLOSING_DISTANCE)


def explain_view_limit(session: Session) -> str | None:
    """Return why ``session`` ends if ``max_views`` views are taken, else None."""
    taken = len(session.views)
    if taken < session.config.max_views:
        return None
    return f"{taken} view{'' if taken == 1 else 's'} taken (max_views)"


def stop_plan(reason: str) -> Plan:
    """Return the plan that ends a run for ``reason``."""
    return Plan(None, 0.0, math.nan, False, (), reason)


def blocked_plan(context: PlanningContext) -> Plan:
    """Return the plan for when no viewpoint is feasible: a panorama first, then the end."""
    if context.has_panorama:
        return stop_plan("no viewpoint left: none that shows the next segment can be reached")
    reason = "no viewpoint is known to be free: look around"
    return Plan(None, 0.0, math.nan, False, (), reason, needs_panorama=True)


def mask_readings(scan: Scan3D, image: RangeImage) -> BoolArray:
    """Return a mask (n_lines, n_beams) of the readings of ``image`` that are points of ``scan``."""
    mask = np.zeros(image.ranges.shape, dtype=bool)
    mask[scan.lines, scan.beams] = True
    return mask


def to_world(context: PlanningContext, viewpoint: Pose2) -> Pose2:
    """Return ``T_world_next`` of a viewpoint given in ``scan``."""
    return context.view.T_world_scan @ viewpoint
