"""Termination, and views of hidden surface in niches and gaps once the contour is complete.

The views along the outline come first, then those of what they could not see, as by P. S. Blaer and
P. K. Allen (View planning and automated data acquisition for three-dimensional modeling of complex
sites, J. Field Robotics 26, 2009).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.model.fused_cloud import thin_by_voxel
from scan3d_twin.core.planning.candidates.hidden_surface import SETTLED_DISTANCE, HiddenSurface
from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import PlanningContext, stop_plan
from scan3d_twin.core.planning.overlap_or_default import expect_accuracy, list_overlaps
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Plan, Pose2, wrap
from scan3d_twin.core.viewpoints import sum_turns

BLOCKED_REASON = "no viewpoint left: none that shows the next segment can be reached"
"""Stop reason of a contour that goes on where the robot cannot."""
STALE_REASON = "nothing new in the latest views: the contour leads nowhere"
"""Stop reason of a contour along which no more of the target shows."""
STALE_VIEWS = 3
"""Number of views without anything new after which the contour leads nowhere (assumption)."""
MIN_NEW_SHARE = 0.03
"""Share of a view's target that must be new: a step with an overlap of 80 % shows 20 %; noise, a
few points at the edges."""
MIN_PROGRESS_TURN = math.radians(30.0)
"""Turn over these views above which they go on round the target [rad]: the turns of three steps
with an overlap of 80 % round a thin thing are 54 deg."""
NEW_DISTANCE = 0.05
"""Distance from known surface beyond which surface is new [m]: the errors of registration, several
times."""
FRUITLESS_VIEWS = 2
"""Number of views of hidden surface that show none, after which the rest is not looked for: one may
be on the way (assumption)."""
MIN_PROGRESS = 0.2
"""Least distance by which a view on the way is nearer to the wanted one [m]: grid_step."""
MAX_TRIED = 20
"""Largest number of viewpoints whose error is predicted; the others show less surface."""
HALFWAY_SHARES = (0.75, 0.5, 0.25)
"""Shares of the way to a viewpoint at which a view in between is tried."""
ViewError = Callable[[Pose2], float]
"""Returns the predicted error [m] of a viewpoint in frame ``scan`` of the latest view."""


def termination_plan(context: PlanningContext, error: ViewError | None = None) -> Plan | None:
    """Return the plan after the last step along the contour; None while there is a next step.

    It ends the run, unless ``planning.closing`` asks for views of hidden surface: then it goes
    where the most of it is expected to show with a predicted error that meets epsilon. So it does
    where the contour goes on, but the robot cannot, as at a wall: the other end is hidden too. A
    contour along which nothing new shows is as good as done, and so are views of hidden surface of
    which the latest ones showed none.

    Args:
        context: After the latest view.
        error: The error of a view of hidden surface; the closed form by default.
    """
    # Look for an end of the contour
    reason = context.termination_reason()
    wanted = context.session.config.planning.closing == "hidden"
    if reason is None:
        if not wanted:
            return None
        if was_blocked(context):
            ranked = _rank_hidden(context, error)
            return (
                _plan_hidden_view(context, ranked)
                or _plan_approach(context)
                or _plan_halfway(context, ranked)
                or stop_plan(BLOCKED_REASON)
            )
        stale = shows_nothing_new(context.session)
        return _plan_more(context, STALE_REASON, error) if stale else None

    # Add views of hidden surface
    if not (wanted and context.is_ongoing and context.is_contour_done):
        return stop_plan(reason)
    return _plan_more(context, reason, error)


def _plan_more(context: PlanningContext, reason: str, error: ViewError | None) -> Plan:
    """Return the plan for more of hidden surface, or else to stop for ``reason``."""
    if closing_shows_nothing(context.session):
        return stop_plan(reason)
    ranked = _rank_hidden(context, error)
    return _plan_hidden_view(context, ranked) or _plan_halfway(context, ranked) or stop_plan(reason)


def shows_nothing_new(session: Session) -> bool:
    """Return whether the latest ``STALE_VIEWS`` views show next to nothing that is new.

    A view shows something new where its target is farther than ``NEW_DISTANCE`` from that of all
    earlier views, or where it looks from another side: the back of a thin thing is close to its
    front.
    """
    first = len(session.views) - STALE_VIEWS
    latest = [view.T_world_scan for view in session.views[max(first - 1, 0) :]]
    if first < 1 or abs(sum_turns(latest)) > MIN_PROGRESS_TURN:
        return False
    return all(
        new <= MIN_NEW_SHARE * all_of_it
        for new, all_of_it in _iterate_new(session, first, NEW_DISTANCE)
    )


def closing_shows_nothing(session: Session) -> bool:
    """Return whether the latest ``FRUITLESS_VIEWS`` views were of hidden surface, and showed none.

    What a view shows that is farther than ``SETTLED_DISTANCE`` from the target in all earlier views
    must be as large as the smallest area for which a view is added. Behind the silhouette of a
    round thing a face is expected that is none.
    """
    # Require that the contour was done before them
    first = len(session.views) - FRUITLESS_VIEWS
    if first < 1 or not PlanningContext(_first_views(session, first)).is_contour_done:
        return False

    # Measure what each shows
    cell, least = SETTLED_DISTANCE**2, session.config.planning.least_hidden
    return all(new * cell < least for new, _ in _iterate_new(session, first, SETTLED_DISTANCE))


def _iterate_new(session: Session, first: int, distance: float) -> Iterator[tuple[int, int]]:
    """Yield how many cells of its target each view from ``first`` on shows: new ones, and all.

    Cells have the side ``distance`` [m]; new ones are farther than it from all earlier views' ones.
    """
    seen = [
        thin_by_voxel(view.T_world_scan.apply(view.target.points), distance)
        for view in session.views
    ]
    for k in range(first, len(seen)):
        off, _ = Tree.of(np.concatenate(seen[:k])).closest(seen[k], distance)
        yield int(np.count_nonzero(~np.isfinite(off))), len(seen[k])


def was_blocked(context: PlanningContext) -> bool:
    """Return whether no viewpoint of the next segment could be reached after any of the views.

    A panorama was taken before that is decided.
    """
    session = context.session
    looked = {taken for taken, _ in session.panoramas if taken > 0}
    return any(_is_blocked(PlanningContext(_first_views(session, k))) for k in sorted(looked))


def _first_views(session: Session, count: int) -> Session:
    """Return ``session`` as it was after its first ``count`` views and the panorama then."""
    panoramas = tuple(each for each in session.panoramas if each[0] <= count)
    return replace(session, views=session.views[:count], panoramas=panoramas)


def _is_blocked(context: PlanningContext) -> bool:
    config = context.session.config.planning
    overlaps = [*list_overlaps(config), config.default_overlap]
    return all(context.find_placement(eta).viewpoint is None for eta in overlaps)


class _Ranked(NamedTuple):
    """Viewpoints from which hidden surface shows, most of it first.

    Attributes:
        candidates: All viewpoints.
        areas: Hidden surface that each shows (n,) [m2].
        wanted: Indices of those worth a view.
        error: Returns their errors [m].
    """

    candidates: PoseCandidates
    areas: FloatArray
    wanted: list[int]
    error: ViewError


def _rank_hidden(context: PlanningContext, error: ViewError | None) -> _Ranked | None:
    """Return the ranked viewpoints; None where no error can be predicted."""
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = HiddenSurface(session).measure_areas(candidates.poses)
    try:
        error = error or ErrorPrediction.of(context).error
    except RegistrationError:
        return None
    order = np.argsort(-areas, kind="stable")
    wanted = [int(i) for i in order[areas[order] >= config.least_hidden][:MAX_TRIED]]
    return _Ranked(candidates, areas, wanted, error)


def _plan_hidden_view(context: PlanningContext, ranked: _Ranked | None) -> Plan | None:
    """Return the plan for the view of the most hidden surface; None if none is worth a view.

    Its predicted error meets the accuracy that the run keeps (``expect_accuracy``).
    """
    if ranked is None:
        return None
    here, accuracy = context.view.T_world_scan, expect_accuracy(context.session)
    for i in ranked.wanted:
        pose = ranked.candidates.poses[i]
        error = ranked.error(here.inverse() @ pose)
        if error <= accuracy:
            reason = f"contour done: {1e4 * ranked.areas[i]:.0f} cm2 more may show"
            return _go(ranked.candidates, pose, reason, error)
    return None


def _plan_halfway(context: PlanningContext, ranked: _Ranked | None) -> Plan | None:
    """Return the plan for a view part of the way to one of hidden surface; None if there is none.

    Where the errors of all those exceed the accuracy that the run keeps, the next view is
    registered on the one that is taken on the way.
    """
    if ranked is None:
        return None
    here, accuracy = context.view.T_world_scan, expect_accuracy(context.session)
    for i in ranked.wanted:
        for pose in _iterate_halfway(here, ranked.candidates.poses[i]):
            step = here.inverse() @ pose
            is_possible = ranked.candidates.is_allowed(pose) and context.is_feasible(step)
            if is_possible and (error := ranked.error(step)) <= accuracy:
                reason = f"contour done: on the way to {1e4 * ranked.areas[i]:.0f} cm2 more"
                return _go(ranked.candidates, pose, reason, error)
    return None


def _plan_approach(context: PlanningContext) -> Plan | None:
    """Return the plan for a view on the way to the most hidden surface; None if there is none.

    From the last view before the robot was blocked, the other end of the target is out of sight.
    The view nearest to the wanted one is taken whose predicted error meets the accuracy that the
    run keeps.
    """
    # Choose the viewpoint to approach
    session, config = context.session, context.session.config.planning
    candidates = PoseCandidates(context)
    areas = HiddenSurface(session).measure_areas(candidates.poses)
    if np.max(areas, initial=0.0) < config.least_hidden:
        return None
    goal, here = candidates.poses[int(np.argmax(areas))], context.view.T_world_scan

    # Take the nearest view to it that can be registered
    try:
        prediction = ErrorPrediction.of(context)
    except RegistrationError:
        return None
    distances = np.array([pose.distance(goal) for pose in candidates.poses])
    order = np.argsort(distances, kind="stable")
    for i in order[distances[order] < here.distance(goal) - MIN_PROGRESS]:
        pose = candidates.poses[i]
        error = prediction.error(here.inverse() @ pose)
        if error <= expect_accuracy(session):
            return candidates.go(pose, "contour blocked: on the way to its other end", error=error)
    return None


def _iterate_halfway(here: Pose2, there: Pose2) -> Iterator[Pose2]:
    """Yield poses between two, the farthest first."""
    turn = wrap(there.yaw - here.yaw)
    for share in HALFWAY_SHARES:
        yield Pose2(
            here.x + share * (there.x - here.x),
            here.y + share * (there.y - here.y),
            here.yaw + share * turn,
        )


def _go(candidates: PoseCandidates, pose: Pose2, reason: str, error: float) -> Plan:
    """Return the plan to go to ``pose``, which falls back if its ``error`` [m] exceeds epsilon."""
    plan = candidates.go(pose, reason, error=error)
    fell_back = plan.predicted_rmse > candidates.session.config.planning.epsilon
    return replace(plan, fell_back=fell_back)
