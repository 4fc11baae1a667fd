"""What a finished contour still hides, and the views that are added for it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_planning, paper_sweep
from sessions import session_at
from synthetic import THREE_BOXES, Box, observe

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.planning.candidates import hidden_views as closing
from scan3d_twin.core.planning.candidates.hidden_surface import FACE_DEPTH, HiddenSurface
from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.candidates.pose_candidates import PoseCandidates
from scan3d_twin.core.planning.context import Placement, PlanningContext
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Observation, Plan, Pose2

pytestmark = pytest.mark.slow

BOXES = tuple(
    Box((box.low[0] + 0.3, *box.low[1:]), (box.high[0] + 0.3, *box.high[1:])) for box in THREE_BOXES
)
"""Side by side with gaps of 0.1 m; the one in the middle goes from x = 1.05 to 1.35."""
BESIDE = (Pose2(0.1, 1.0, math.radians(-25.0)), Pose2(0.1, -1.0, math.radians(25.0)))
WIDE = replace(paper_config(), sweep=paper_sweep(width=math.radians(90.0)))


def standing(x: float, y: float) -> Pose2:
    """Return the pose at a place that faces the front."""
    return Pose2(x, y, 0.0)


@pytest.fixture(scope="module")
def seen() -> Session:
    """Return three boxes with gaps of 0.1 m, as seen from beside them on both sides."""
    return session_at(BOXES, WIDE, poses=BESIDE, half=1.2)


def on_face(session: Session, y: float, outward: float) -> FloatArray:
    """Return the x of the hidden pieces on a side face at ``y``, (n,)."""
    faces = HiddenSurface(session).faces
    side = (np.abs(faces.points[:, 1] - y) < 0.04) & (faces.normals[:, 1] * outward > 0.8)
    return faces.points[side, 0]


def test_the_sides_in_the_gaps_are_expected_and_not_seen(seen: Session) -> None:
    for y, outward in ((0.25, 1.0), (-0.15, -1.0)):
        places = on_face(seen, y, outward)
        assert len(places) > 10
        assert places.min() > 1.05
        assert places.max() < 1.05 + FACE_DEPTH


def test_what_was_seen_is_not_hidden(seen: Session) -> None:
    assert len(on_face(seen, 1.15, 1.0)) == 0
    assert len(on_face(seen, -1.15, -1.0)) == 0


def test_a_viewpoint_shows_what_it_looks_at_and_no_surface_hides(seen: Session) -> None:
    hidden = HiddenSurface(seen)
    into, away = hidden.measure_areas([standing(-0.1, 0.55), Pose2(-0.1, 0.55, math.pi)])
    assert into > 0.005
    assert away == 0.0
    gap = hidden.faces.select(np.abs(hidden.faces.points[:, 1] - 0.25) < 0.04)
    # The front of the box on the left stands before the gap beside it.
    assert hidden.slices.find_hidden(gap, np.array([0.3, 1.6])).all()
    assert not hidden.slices.find_hidden(gap, np.array([-0.1, 0.55])).all()


def test_what_a_view_into_the_gap_settled_is_hidden_no_more(seen: Session) -> None:
    poses = [view.observation.T_odom_scan for view in seen.views]
    more = session_at(BOXES, WIDE, poses=(*poses, standing(-0.1, 0.7)), half=1.2)
    before, after = (on_face(each, 0.25, 1.0) for each in (seen, more))
    depth = 1.17  # as far as the box on the left lets it see
    assert np.count_nonzero(before < depth) > 10
    assert np.count_nonzero(after < depth) <= 2
    assert np.count_nonzero(after > depth) > 10


@pytest.mark.parametrize(("right", "left", "hidden"), [(-5.0, 45.0, True), (-45.0, 5.0, False)])
def test_a_sweep_to_one_side_settles_nothing_on_the_other(
    seen: Session, right: float, left: float, hidden: bool
) -> None:
    """The gap lies to the right, at 20 to 25 deg."""
    there = standing(-0.1, 0.7)
    image = observe(there, BOXES, room=False, width=math.radians(90.0)).image
    front = np.degrees(image.yaws[:, image.spec.n_beams // 2])
    kept = (front >= right) & (front <= left)
    image = replace(
        image, stamps=image.stamps[kept], yaws=image.yaws[kept], ranges=image.ranges[kept],
        codes=image.codes[kept],
    )  # fmt: skip
    more = integrate(seen, Observation(image, there))
    before, after = (np.count_nonzero(on_face(each, 0.25, 1.0) < 1.17) for each in (seen, more))
    assert after > 0.8 * before if hidden else after <= 2


@pytest.mark.parametrize("seed", range(8))
def test_noise_does_not_decide_how_much_is_hidden(seed: int) -> None:
    """The sides in the gaps are expected, and show to one who looks into them, with any noise."""
    session = session_at(BOXES, WIDE, poses=BESIDE, half=1.2, sigma=0.008, seed=seed)
    for y, outward in ((0.25, 1.0), (-0.15, -1.0)):
        assert len(on_face(session, y, outward)) >= 50  # of 29 in each of two slices
    area = HiddenSurface(session).measure_areas([standing(-0.1, 0.7)])[0]
    assert area == pytest.approx(0.016, abs=0.005)


def test_an_edge_that_two_views_saw_counts_once(seen: Session) -> None:
    again = session_at(BOXES, WIDE, poses=(*BESIDE, *BESIDE), half=1.2)
    areas = [HiddenSurface(each).measure_areas([standing(-0.1, 0.7)])[0] for each in (seen, again)]
    assert areas[1] == pytest.approx(areas[0], rel=0.4)


def test_a_flat_sight_settles_nothing(seen: Session) -> None:
    """Beams along a face pass it by a finger's breadth and say nothing of it."""
    along = session_at(BOXES, WIDE, poses=(*BESIDE, standing(-0.1, 0.3)), half=1.2)
    before, after = (on_face(each, 0.25, 1.0) for each in (seen, along))
    assert len(after) > 0.8 * len(before)


def finished(session: Session, how: str) -> PlanningContext:
    """Return the context after a session whose contour is done."""
    planning = replace(paper_planning(), closing=how, epsilon=10.0)  # type: ignore[arg-type]
    context = PlanningContext(replace(session, config=replace(session.config, planning=planning)))
    context.__dict__["is_contour_done"] = True
    return context


def test_a_finished_contour_ends_the_run_unless_more_is_wanted(seen: Session) -> None:
    plan = termination_plan(finished(seen, "none"))
    assert plan is not None
    assert plan.viewpoint is None
    assert plan.reason == "front complete"


def test_a_view_is_added_where_most_may_show(seen: Session) -> None:
    context = finished(seen, "hidden")
    plan = termination_plan(context)
    assert plan is not None
    assert plan.viewpoint is not None
    areas = HiddenSurface(context.session).measure_areas(PoseCandidates(context).poses)
    assert HiddenSurface(context.session).measure_areas([plan.viewpoint])[0] == pytest.approx(
        areas.max()
    )


def test_no_view_is_added_that_would_not_register(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closing.ErrorPrediction, "error", lambda self, viewpoint: math.inf)
    plan = termination_plan(finished(seen, "hidden"))
    assert plan is not None
    assert plan.viewpoint is None


def test_a_step_along_the_contour_comes_first(seen: Session) -> None:
    context = finished(seen, "hidden")
    context.__dict__["is_contour_done"] = False
    assert termination_plan(context) is None


def test_a_contour_that_was_done_stays_done() -> None:
    end = Pose2(0.4, -1.6, math.radians(40.0))
    session = session_at(BOXES, WIDE, poses=(end,), half=1.2)
    assert PlanningContext(session).is_contour_done
    on = session_at(BOXES, WIDE, poses=(end, standing(-0.1, 0.0)), half=1.2)
    assert not PlanningContext(replace(on, views=on.views[1:])).is_contour_done
    assert PlanningContext(on).is_contour_done


def blocked(session: Session, monkeypatch: pytest.MonkeyPatch) -> PlanningContext:
    """Return the context of a contour that goes on where the robot cannot."""
    monkeypatch.setattr(
        PlanningContext, "find_placement", lambda self, overlap: Placement(None, False)
    )
    context = finished(session, "hidden")
    context.__dict__["is_contour_done"] = False
    return context


def test_where_the_contour_is_blocked_what_is_hidden_elsewhere_comes_next(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = termination_plan(blocked(seen, monkeypatch))
    assert plan is not None
    assert plan.viewpoint is not None


def test_only_a_panorama_can_tell_that_the_contour_is_blocked(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    unseen = replace(seen, panoramas=seen.panoramas[:1])
    assert termination_plan(blocked(unseen, monkeypatch)) is None


def test_what_is_too_far_to_register_is_approached(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No view of hidden surface registers on the latest one, but others on the way to it do."""
    context = blocked(seen, monkeypatch)
    candidates, here = PoseCandidates(context), context.view.T_world_scan
    farthest = int(np.argmax([pose.distance(here) for pose in candidates.poses]))
    goal, areas = candidates.poses[farthest], np.zeros(len(candidates.poses))
    areas[farthest] = 0.1
    monkeypatch.setattr(HiddenSurface, "measure_areas", lambda self, poses: areas)

    def error(prediction: object, step: Pose2) -> float:
        return math.inf if (here @ step).distance(goal) < 0.8 else 0.001

    monkeypatch.setattr(closing.ErrorPrediction, "error", error)
    monkeypatch.setattr(closing, "MAX_TRIED", 0)
    plan = termination_plan(context)
    assert plan is not None
    assert plan.viewpoint is not None
    near = min(d for pose in candidates.poses if (d := pose.distance(goal)) >= 0.8)
    assert plan.viewpoint.distance(goal) == pytest.approx(near)
    assert near < here.distance(goal)


def test_a_blocked_contour_ends_the_run_when_nothing_registers(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closing.ErrorPrediction, "error", lambda self, viewpoint: math.inf)
    plan = termination_plan(blocked(seen, monkeypatch))
    assert plan is not None
    assert plan.viewpoint is None
    assert plan.reason == closing.BLOCKED_REASON


def test_a_contour_along_which_nothing_new_shows_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    left, middle, right = standing(-0.1, 0.9), standing(-0.1, 0.0), standing(-0.1, -0.9)
    again = session_at(BOXES, WIDE, poses=(left, middle, right, left, middle, right), half=1.2)
    assert closing.shows_nothing_new(again)
    assert not closing.shows_nothing_new(replace(again, views=again.views[:5]))
    assert not closing.shows_nothing_new(replace(again, views=again.views[:2]))
    monkeypatch.setattr(closing.ErrorPrediction, "error", lambda self, viewpoint: math.inf)
    context = finished(again, "hidden")
    context.__dict__["is_contour_done"] = False
    monkeypatch.setattr(closing, "was_blocked", lambda context: False)
    plan = termination_plan(context)
    assert plan is not None
    assert plan.reason == closing.STALE_REASON


def test_another_side_of_a_thin_thing_is_new_although_it_is_close_to_the_first() -> None:
    pole = (Box((0.985, -0.015, 0.0), (1.015, 0.015, 1.0)),)
    around = [
        Pose2(1.0 - math.cos(a), -math.sin(a), a)  # counter-clockwise
        for a in np.radians([0.0, 20.0, 40.0, 60.0])
    ]
    session = session_at(pole, WIDE, poses=tuple(around), half=0.02)
    assert not closing.shows_nothing_new(session)
    same = session_at(pole, WIDE, poses=(around[0],) * 4, half=0.02)
    assert closing.shows_nothing_new(same)


def farther_than(limit: float) -> Callable[[object, Pose2], float]:
    """Return an error of 4 mm up to a distance of ``limit`` [m], and of 40 mm beyond."""
    return lambda self, viewpoint: 0.004 if math.hypot(viewpoint.x, viewpoint.y) <= limit else 0.04


def strict(context: PlanningContext, epsilon: float) -> PlanningContext:
    """Return ``context`` with another epsilon [m]."""
    session = context.session
    planning = replace(session.config.planning, epsilon=epsilon)
    made = PlanningContext(replace(session, config=replace(session.config, planning=planning)))
    made.__dict__["is_contour_done"] = True
    return made


def test_a_view_out_of_reach_is_approached_in_steps(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = strict(finished(seen, "hidden"), 0.01)
    monkeypatch.setattr(closing.ErrorPrediction, "error", farther_than(1e-3))
    assert (plan := termination_plan(context)) is not None
    assert plan.viewpoint is None
    monkeypatch.setattr(closing.ErrorPrediction, "error", farther_than(0.55))
    assert (plan := termination_plan(context)) is not None
    assert plan.viewpoint is not None
    assert 0.1 < plan.viewpoint.distance(context.view.T_world_scan) <= 0.55
    assert plan.predicted_rmse == 0.004
    assert not plan.fell_back


def test_a_run_that_cannot_meet_epsilon_still_adds_views(
    seen: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(closing.ErrorPrediction, "error", farther_than(10.0))
    context = strict(finished(seen, "hidden"), 0.003)
    assert (plan := termination_plan(context)) is not None
    assert plan.viewpoint is None
    accepted = Plan(Pose2(), 0.8, 0.0041, True, (), "for a test")
    context = strict(PlanningContext(replace(context.session, plans=(accepted,))), 0.003)
    assert (plan := termination_plan(context)) is not None
    assert plan.viewpoint is not None
    assert plan.fell_back


def test_views_of_hidden_surface_end_when_they_show_none(seen: Session) -> None:
    """Two views of what is known already end them; one that looks into a gap does not."""
    known, end, gap = BESIDE[0], Pose2(0.4, -1.6, math.radians(40.0)), standing(-0.1, 0.7)
    for last, fruitless in ((gap, False), (known, True)):
        again = session_at(BOXES, WIDE, poses=(known, end, known, last), half=1.2)
        assert closing.closing_shows_nothing(again) == fruitless
        assert not closing.closing_shows_nothing(replace(again, views=again.views[:3]))
    assert (plan := termination_plan(finished(again, "hidden"))) is not None
    assert plan.viewpoint is None
    assert plan.reason == "front complete"


def test_a_view_of_hidden_surface_is_checked_like_any_other(seen: Session) -> None:
    tried: list[Pose2] = []

    def error(viewpoint: Pose2) -> float:
        tried.append(viewpoint)
        return math.inf

    assert (plan := termination_plan(finished(seen, "hidden"), error)) is not None
    assert plan.viewpoint is None
    assert tried
