import json
import math
from dataclasses import replace

import jsonschema
import pytest

from scan3d_twin.core.model.evaluation import Distances, Evaluation
from scan3d_twin.core.model.pose_errors import PairError
from scan3d_twin.run.report import (
    TIMING_FIELDS,
    Effort,
    Journey,
    build_report,
    failure_reason,
    report_json,
    report_schema,
)
from scan3d_twin.run.settings import Settings

EVALUATION = Evaluation(
    coverage=0.9312345,
    coverage_by_view=(0.7, 0.9312345),
    accuracy=Distances(0.005, 0.004, 0.011),
    completeness=Distances(0.006, 0.005, 0.021),
    f_score={0.010: 0.7, 0.020: 0.9, 0.030: 0.95},
    coverable_share=0.61,
    pairs=(PairError(1, 0.0042, 0.0051, 0.0301),),
)


def report(session, evaluation=EVALUATION):
    """Return the report of ``session`` with a made-up journey and effort."""
    journey = Journey(path=2.5, turn=math.pi, duration=100.0)
    effort = Effort(wall_time=4.0, plan_time=0.5, peak_memory=2e8)
    return build_report("three_boxes", Settings(), session, journey, effort, 123, evaluation)


def test_a_report_fits_its_schema(session):
    schema = report_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(report_json(report(session))), schema)


def test_a_report_without_truth_fits_its_schema(session):
    blind = report(session, evaluation=None)
    jsonschema.validate(blind, report_schema())
    assert blind["coverage_20mm"] is None
    assert blind["registration"][0]["error_mm"] is None


def test_a_report_of_one_view_fits_its_schema(session):
    jsonschema.validate(report(replace(session, views=session.views[:1])), report_schema())


@pytest.mark.parametrize(
    ("key", "value"),
    [("views", -1), ("views", "2"), ("tour", "back"), ("extra", 1), ("path_m", None)],
)
def test_the_schema_refuses_what_is_no_report(session, key, value):
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(report(session) | {key: value}, report_schema())


def test_numbers_are_in_the_units_of_their_names(session):
    result = report(session)
    assert result["epsilon_mm"] == 10.0
    assert result["turn_deg"] == 180.0
    assert result["sim_time_s"] == 100.0
    assert result["real_time_factor"] == 25.0
    assert result["peak_memory_mb"] == 200.0
    assert result["accuracy_mm"] == {"mean": 5.0, "median": 4.0, "p95": 11.0}
    assert result["f_score"] == {"10": 0.7, "20": 0.9, "30": 0.95}
    row = result["registration"][0]
    assert (row["view"], row["error_mm"], row["odometry_error_mm"]) == (1, 4.2, 30.1)
    assert result["max_registration_error_mm"] == 4.2


def test_what_is_not_a_number_is_null(session):
    assert report(session)["registration"][0]["predicted_rmse_mm"] is None
    assert "NaN" not in report_json(report(session))


def test_the_timings_are_fields_of_the_report(session):
    assert set(TIMING_FIELDS) < set(report(session))


def test_two_registered_views_without_a_prediction_are_no_failure(session):
    assert failure_reason(session) == ""


def test_one_registered_view_is_a_failure(session):
    lost = replace(session.views[1].registration, converged=False)
    views = (session.views[0], replace(session.views[1], registration=lost))
    assert failure_reason(replace(session, views=views)).startswith("1 of 2 views registered")
    assert failure_reason(replace(session, views=views[:1])).startswith("1 of 1 views registered")


def test_one_registered_view_is_enough_where_one_was_wanted(session):
    one = replace(session, config=replace(session.config, max_views=1))
    assert failure_reason(replace(one, views=one.views[:1], plans=())) == ""
    assert failure_reason(replace(one, views=(), plans=())).startswith("0 of 0 views registered")


def test_predictions_above_epsilon_are_no_failure(session):
    above = replace(session.plans[0], predicted_rmse=0.0101, fell_back=True)
    assert failure_reason(replace(session, plans=(above, above))) == ""
