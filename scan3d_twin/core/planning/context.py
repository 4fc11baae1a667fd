"""What every planner asks first: is the tour finished, and where would one stand for an overlap?"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from scan3d_twin.core.navigation.costmap import Costmap, build_costmap
from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.planning.surface_prediction import Prediction, predict
from scan3d_twin.core.scanning.smoothing import smooth
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, Plan, Pose2, RangeImage, Scan3D, wrap
from scan3d_twin.core.viewpoints import (
    BEND,
    FRONT_SIDE,
    HERE,
    Contour,
    angle_between,
    bends_after,
    contour_of,
    corner_angle,
    ends_in_view,
    foreseen_segment,
    limit,
    line_means,
    next_segment,
    place,
    sweep_width,
    well_seen,
)

MIN_LINES = 5
"""A target seen in fewer lines gives no contour to go along."""
NEARLY_ROUND = math.radians(240.0)
"""Turn since the first view after which the contour may close; three sides of a box are 270 deg."""
BESIDE_TOLERANCE = math.radians(20.0)
"""A view this near to ``FRONT_SIDE`` ends a tour of the front: one more would show little new."""
CLOSED = 0.10
"""The contour is closed when its end comes this near to where it began [m]: a few times the drift
of a dozen registered views."""


@dataclass(frozen=True)
class Placement:
    """Where to stand for one overlap.

    Attributes:
        viewpoint: ``T_scan_next`` in frame ``scan`` of the latest view; None if none is feasible.
        wanted: Whether it is the viewpoint the geometry asks for, not a substitute for it.
    """

    viewpoint: Pose2 | None
    wanted: bool


@dataclass(frozen=True)
class PlanningContext:
    """The latest view and what follows from it."""

    session: Session
    known_costmap: Costmap | None = None
    """The costmap of ``session`` where the caller has built it already."""

    @property
    def view(self) -> View:
        """The latest view."""
        return self.session.views[-1]

    @cached_property
    def P(self) -> Scan3D:
        """The paper's P: the target in the latest view, up to where it is seen too flat."""
        lines = well_seen(self._whole)
        return self._seen if lines == len(self._whole.points) else self._seen.first_lines(lines)

    @cached_property
    def _seen(self) -> Scan3D:
        """The target in the latest view, without what the sweep's margins show of it."""
        target, sweep = self.view.target, self.session.config.sweep
        if sweep.margin == 0.0:
            return target
        yaws = self.view.image.yaws[:, self.view.image.spec.n_beams // 2]
        return target.select((np.abs(yaws) <= sweep.width / 2)[target.lines])

    @cached_property
    def _whole(self) -> Contour:
        """The contour of all that is seen of the target in the latest view."""
        return contour_of(self._seen)

    @cached_property
    def contour(self) -> Contour:
        """The contour of P."""
        return self._whole if self.P is self._seen else contour_of(self.P)

    @cached_property
    def ends(self) -> bool:
        """Whether the target ends with P, or turns around a corner there, on the travel side."""
        view = self.view
        if self._goes_on:
            return False
        if len(self._whole.points) - self.n_lines >= MIN_LINES:
            return bends_after(self._whole, self.n_lines)
        return ends_in_view(view.image, view.sweep, view.target, self.session.config.target)

    @cached_property
    def _goes_on(self) -> bool:
        """Whether the sweep's margin shows more of the target's front on the travel side."""
        beyond = len(self.view.target.occupied_lines) - len(self._seen.occupied_lines)
        if self.session.config.tour != "front" or beyond < MIN_LINES:
            return False
        contour = contour_of(self.view.target)
        last = int(self._seen.occupied_lines[-1])
        first = int(np.searchsorted(self.view.target.occupied_lines, last))
        if len(contour.points) - first < MIN_LINES:
            return False
        return abs(angle_between(self._front, contour.normal(first))) < FRONT_SIDE

    @cached_property
    def foreseen(self) -> Prediction | None:
        """The surface predicted beyond P, if that is wanted and the hold-out was good."""
        config = self.session.config.planning
        if config.foresight == "none":
            return None
        prediction = predict(line_means(self.P))
        if prediction is None or prediction.sigma > config.foresight_sigma:
            return None
        return prediction

    @cached_property
    def smoothed(self) -> RangeImage:
        """The latest range image without most of its noise."""
        return smooth(self.view.image)

    @cached_property
    def costmap(self) -> Costmap:
        """Where the robot can go from here."""
        if self.known_costmap is not None:
            return self.known_costmap
        session = self.session
        start = self.view.observation.T_odom_scan
        return build_costmap(session.observations(), session.config, start)

    @property
    def looked(self) -> bool:
        """Whether the robot has looked around since the latest view."""
        return any(taken == len(self.session.views) for taken, _ in self.session.panoramas)

    @cached_property
    def n_lines(self) -> int:
        """The paper's n: lines of P."""
        return len(self.P.occupied_lines)

    def n_Q(self, overlap: float) -> int:
        """Return the number of overlapping lines for ``overlap``, eta * n."""
        return max(2, round(overlap * self.n_lines))

    def place(self, overlap: float) -> Placement:
        """Return where to stand to see ``overlap`` of the current lines again."""
        config = self.session.config
        beyond = self._front if config.tour == "front" else None
        n_Q, S1 = self.n_Q(overlap), sweep_width(config)
        if self.foreseen is not None and not self.ends:
            segment = foreseen_segment(self.contour, n_Q, S1, self.foreseen.points)
        else:
            segment = next_segment(self.contour, n_Q, S1, beyond, ends=self.ends, bend=self._bend)
        if config.tour == "front":
            segment = replace(segment, normal=limit(segment.normal, self._front, FRONT_SIDE))
        viewpoint, wanted = place(segment, config, self.feasible)
        return Placement(viewpoint, wanted)

    def feasible(self, viewpoint: Pose2) -> bool:
        """Tell whether the robot can get to ``viewpoint``, given in ``scan``, and stand there."""
        there = self.view.observation.T_odom_scan @ viewpoint
        return self.costmap.feasible(there.x, there.y)

    def finished(self) -> str | None:
        """Return why the tour is finished, or None while there is more to scan."""
        if not self._in_sight:
            return "target lost: the latest view shows nothing of it"
        if self._used_up:
            return f"max_views: {len(self.session.views)} views taken"
        if not self.contour_done:
            return None
        return "front complete" if self.session.config.tour == "front" else "contour complete"

    @property
    def going(self) -> bool:
        """Whether the latest view shows the target and another one may follow."""
        return self._in_sight and not self._used_up

    @property
    def _in_sight(self) -> bool:
        return len(self._seen.occupied_lines) >= MIN_LINES

    @property
    def _used_up(self) -> bool:
        return len(self.session.views) >= self.session.config.max_views

    @cached_property
    def contour_done(self) -> bool:
        """Whether the contour was followed to its end, by the latest view or an earlier one."""
        if self._in_sight and self._ends_contour():
            return True
        earlier = self.session.views[:-1]
        return bool(earlier) and PlanningContext(replace(self.session, views=earlier)).contour_done

    def _ends_contour(self) -> bool:
        if self.session.config.tour == "front":
            return self._beside_front() and self.ends
        return self._closed()

    @cached_property
    def _bend(self) -> float:
        """Angle by which the contour is expected to bend where it ends in view [rad]."""
        wanted = self.session.config.planning.corner_model
        return corner_angle(self.contour) if wanted == "contour" else BEND

    @cached_property
    def _front(self) -> FloatArray:
        """Outward unit normal (2,) in ``scan`` of the target's front as the robot first saw it."""
        return self.view.T_world_scan.inverse().rotate(self.session.front)

    def _beside_front(self) -> bool:
        """Tell whether the latest view already looked at the front from its far side."""
        return angle_between(self._front, HERE) >= FRONT_SIDE - BESIDE_TOLERANCE

    def _closed(self) -> bool:
        """Tell whether a tour all round has come back to where the first view began."""
        views = self.session.views
        yaws = [view.T_world_scan.yaw for view in views]
        turned = sum(wrap(b - a) for a, b in pairwise(yaws))
        if turned < NEARLY_ROUND:
            return False
        if turned >= math.tau:
            return True
        first = views[0].T_world_scan.apply(contour_of(views[0].target).points)
        end = self.view.T_world_scan.apply(self.contour.points[-1])
        return bool(nearest(cKDTree(first), end)[0] <= CLOSED)


def finish(reason: str) -> Plan:
    """Return the plan that ends a run."""
    return Plan(None, 0.0, math.nan, False, (), reason)


def blocked(context: PlanningContext) -> Plan:
    """Return the plan for when no viewpoint can be reached: look around first, then give up."""
    if context.looked:
        return finish("no viewpoint left: none that shows the next segment can be reached")
    reason = "no viewpoint is known to be free: look around"
    return Plan(None, 0.0, math.nan, False, (), reason, needs_panorama=True)


def readings_of(scan: Scan3D, image: RangeImage) -> BoolArray:
    """Return which readings (n_lines, n_beams) of ``image`` the points of ``scan`` are."""
    mask = np.zeros(image.ranges.shape, dtype=bool)
    mask[scan.lines, scan.beams] = True
    return mask


def in_world(context: PlanningContext, viewpoint: Pose2) -> Pose2:
    """Return ``T_world_next`` of a viewpoint given in ``scan``."""
    return context.view.T_world_scan @ viewpoint
