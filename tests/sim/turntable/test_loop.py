"""The whole loop with a turntable, and on a stand: one seed."""

from dataclasses import replace

import pytest

import scan3d_twin as s3d
from scan3d_twin.core.stand import STAND_REASON
from scan3d_twin.run.report import failure_reason

SEED = 1001


def twin(pattern, robot="create2"):
    return replace(s3d.TwinConfig.of("typical", robot), pattern=pattern)


@pytest.mark.parametrize("pattern", ["pitch"])  # more of each: docs/patterns.md
def test_two_views_by_a_servo_are_registered_within_the_accuracy(pattern):
    config = twin(pattern)
    with s3d.open_sim("three_boxes", SEED, config) as (robot, truth):
        session = s3d.digitize(robot, s3d.Config(max_views=2), seed=SEED)
        result = s3d.evaluate(session, truth)
    assert len(session.views) == 2
    assert result.pairs[0].error < 0.010
    assert result.pairs[0].odometry_error > 0.010  # it was not so before registration
    assert result.accuracy.median < 0.008


def test_a_stand_takes_one_view_and_says_why_no_other():
    config = twin("yaw", "stand")
    with s3d.open_sim("three_boxes", SEED, config) as (robot, truth):
        session = s3d.digitize(robot, seed=SEED)
        result = s3d.evaluate(session, truth)
    assert (len(session.views), session.stop_reason) == (1, STAND_REASON)
    assert failure_reason(session) == ""
    assert result.accuracy.median < 0.008
    assert result.coverage > 0.3
