"""What the points of a model can be coloured by."""

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.model.evaluation import Comparison
from scan3d_twin.core.model.fused_cloud import Model, build_model
from scan3d_twin.viz.pages.point_values import count_views, expect_errors, measure_points


def model_of(places, views):
    """Return a model of points at ``places`` along x [m], each seen by one of ``views``."""
    points = np.column_stack([places, np.zeros((len(places), 2))])
    return Model(points, np.full_like(points, np.nan), np.full(len(places), 0.003), np.array(views))


def test_points_in_one_place_are_seen_by_as_many_views_as_are_there():
    model = model_of([0.001, 0.002, 0.010, 0.500], [0, 1, 1, 1])
    assert count_views(model).tolist() == [2, 2, 2, 1]
    assert count_views(model.select(np.zeros(4, dtype=bool))).shape == (0,)


def test_the_expected_error_grows_from_view_to_view_by_what_each_registration_adds(session):
    model = model_of([0.0, 0.1, 0.2], [0, 1, 2])
    errors = [
        session.config.registration.calibration * view.registration.predicted_rmse
        for view in session.views[1:]
    ]
    expected = np.sqrt(0.003**2 + np.cumsum([0.0, *np.square(errors)]))
    assert expect_errors(model, session) == pytest.approx(expected)


def test_what_is_not_registered_has_no_bound_and_looks_worst(session):
    lost = replace(session.views[1].registration, converged=False)
    broken = replace(
        session, views=(session.views[0], replace(session.views[1], registration=lost))
    )
    model = model_of([0.0, 0.1], [0, 1])
    assert expect_errors(model, broken).tolist() == [0.003, np.inf]
    expected = measure_points(model, broken, None)[1]
    assert expected.to_bytes().tolist() == [38, 255]


def test_distances_to_the_truth_are_told_only_where_it_is_known(session):
    model = build_model(session)
    none = np.zeros((0, 3))
    compared = Comparison(np.full(len(model), 0.004), np.zeros(0), none, none)
    names = [each.name for each in measure_points(model, session, None)]
    assert names == ["views that saw it", "expected error"]
    distance = measure_points(model, session, compared)[-1]
    assert (distance.name, distance.unit, distance.high) == ("distance to the truth", "mm", 20.0)
    assert set(distance.to_bytes().tolist()) == {51}
