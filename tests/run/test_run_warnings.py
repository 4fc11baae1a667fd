import math
from dataclasses import replace

import numpy as np
from paper import paper_config

from scan3d_twin.core.mapping.error_check import ErrorCheck
from scan3d_twin.core.mapping.odometry_check import TurnError
from scan3d_twin.core.model.evaluation import Distances, Evaluation
from scan3d_twin.core.model.pose_errors import PairError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2, read_only
from scan3d_twin.run import run_warnings
from scan3d_twin.run.run_warnings import find_warnings


def of_pairs(*pairs, f20=0.9, left_out=()):
    """Return an evaluation with these registration errors and nothing else."""
    none = Distances(0.0, 0.0, 0.0)
    return Evaluation(1.0, (1.0,), none, none, {0.020: f20}, 1.0, pairs, ("left",), left_out)


def with_registration(session, **changes):
    """Return ``session`` with another registration of its last view."""
    last = session.views[-1]
    changed = replace(last, registration=replace(last.registration, **changes))
    return replace(session, views=(*session.views[:-1], changed))


def planned(session, **changes):
    """Return ``session`` whose first plan has a viewpoint, with ``changes``."""
    plan = replace(session.plans[0], fell_back=False, viewpoint=Pose2())
    return replace(session, plans=(replace(plan, **changes), *session.plans[1:-1], plan))


def warns(session, *words, evaluation=None):
    """Return the warnings that contain all ``words``."""
    return [line for line in find_warnings(session, evaluation) if all(w in line for w in words)]


def test_a_good_run_has_nothing_to_tell(session):
    good = with_registration(planned(session), converged=True, predicted_rmse=0.004)
    assert find_warnings(good, of_pairs(PairError(1, 0.009, 0.02, 0.03))) == []


def test_notes_on_the_scene_come_first(session):
    assert find_warnings(session, notes=["The mesh was turned."])[0] == "The mesh was turned."


def test_a_target_that_nobody_can_see_is_told(session):
    unseen = replace(of_pairs(), coverable_share=0.0)
    assert warns(session, "Nothing of the target can be seen", evaluation=unseen)
    assert not warns(session, "Nothing of the target", evaluation=of_pairs())


def test_a_step_above_epsilon_is_told_with_the_view_it_led_to(session):
    fallen = planned(session, fell_back=True, overlap=0.8, predicted_rmse=0.0123)
    assert warns(fallen, "View 1:", "10 mm", "overlap of 80%")
    assert warns(fallen, "10 mm is below the expected 12.3 mm")
    assert not warns(planned(session), "below the expected")


def test_an_unregistered_view_is_told(session):
    assert warns(
        with_registration(session, converged=False), "View 1 is not registered", "converge"
    )
    apart = with_registration(session, converged=False, num_inliers=0)
    assert warns(apart, "do not overlap", "odometry alone")


def test_an_ambiguous_and_an_undetermined_registration_are_told(session):
    assert warns(with_registration(session, ambiguity_gap=0.02), "View 1", "fits almost as well")
    open_ones = with_registration(session, degenerate_directions=read_only(np.eye(6)[:2]))
    assert warns(open_ones, "View 1", "2 direction(s) open")


def test_a_large_error_is_told_as_it_is_known(session):
    known = of_pairs(PairError(1, 0.0171, 0.02, 0.03))
    assert warns(session, "View 1", "17.1 mm off", evaluation=known)
    expected = with_registration(session, converged=True, predicted_rmse=0.0234)
    most = f"may be off by {23.4 * session.config.registration.calibration:.1f} mm"
    assert warns(expected, most)
    assert warns(expected, most, evaluation=known)
    unknown = with_registration(session, converged=True, predicted_rmse=math.nan)
    assert not warns(unknown, "may be off")


def test_a_blind_sweep_is_told(session):
    view = session.views[0]
    image = view.observation.image
    ranges = np.where(np.arange(image.n_lines)[:, None] % 5 == 0, image.ranges, np.nan)
    dim = replace(image, ranges=read_only(ranges))
    blind = replace(
        view,
        observation=replace(view.observation, image=dim),
        target=view.target.select(np.arange(len(view.target)) < 40),
    )
    dark = replace(session, views=(blind, *session.views[1:]))
    assert warns(dark, "View 0", "of the readings came back")
    assert warns(dark, "View 0", "only 40 points")


def test_no_view_at_all_is_told():
    empty = Session(paper_config(), 0, np.zeros((1, 2)), np.array([-1.0, 0.0]))
    assert find_warnings(empty) == ["Nothing was scanned: there is no view."]


def test_a_view_that_does_not_fit_is_told(session):
    assert warns(replace(session, misfits=(1,)), "View 1 does not fit", "alignment.misfits")


def test_a_model_of_much_else_and_other_targets_are_told(session):
    assert not warns(session, "F-score", evaluation=of_pairs(f20=0.3))
    assert warns(session, "not that of the target", "0.29", evaluation=of_pairs(f20=0.29))
    assert not warns(session, "other targets", evaluation=of_pairs())
    (told,) = warns(session, "other targets", evaluation=of_pairs(left_out=("right",)))
    assert "right" in told
    assert "judged by left" in told


def test_odometry_that_disagrees_is_told_once(session, monkeypatch):
    error = TurnError(scale=0.07, sigma=0.005, proofs=3, gamma=0.013)
    monkeypatch.setattr(run_warnings, "measure_turn_error", lambda session: error)
    assert warns(session, "turns 7.0% more than it says", "wrong model")
    told = []
    check = run_warnings.AssumptionCheck(told.append)
    check.on_view(session)
    check.on_view(session)
    assert len(told) == 1
    assert told[0].startswith("warning: The base turns 7.0% more")


def test_errors_larger_than_assumed_are_told_once_and_widen_what_is_reported(session, monkeypatch):
    expected = with_registration(session, converged=True, predicted_rmse=0.006)
    reported = 6.0 * session.config.registration.calibration
    assert warns(expected, f"may be off by {reported:.1f} mm")
    worse = ErrorCheck(readings=2.0, shared=1.5, pairs=3)
    monkeypatch.setattr(run_warnings, "check_errors", lambda session: worse)
    (told,) = warns(expected, "worse than assumed")
    assert "readings scatter 2.0 times as widely" in told
    assert "share are 1.5 times the usual ones" in told
    assert "Errors may be 2.0 times the predicted ones" in told
    assert warns(expected, f"may be off by {2.0 * reported:.1f} mm")

    said = []
    check = run_warnings.AssumptionCheck(said.append)
    check.on_view(session)
    check.on_view(session)
    assert len([words for words in said if "worse than assumed" in words]) == 1
