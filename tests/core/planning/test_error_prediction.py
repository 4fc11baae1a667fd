"""What the closed form predicts before driving, beside what the registration then reports."""

from __future__ import annotations

import math

import numpy as np
import pytest
from synthetic import Box, observe

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Observation, Pose2
from scan3d_twin.run.settings import build_settings

pytestmark = pytest.mark.slow

PLATE = (Box((1.0, -0.3, 0.0), (1.15, 0.3, 0.7)),)
BOX = (Box((1.0, -0.3, 0.0), (1.6, 0.3, 0.7)),)
CONFIG = build_settings([preset_options("best")]).config


def view_from(
    session: Session, boxes: tuple[Box, ...], pose: Pose2, room: bool, seed: int
) -> Session:
    """Return the session with one more view from where the odometry has the robot."""
    rng, width = np.random.default_rng(seed), math.radians(150.0)
    seen = observe(pose, boxes, room=room, sigma=0.004, width=width, rng=rng)
    return integrate(session, Observation(seen.image, pose))


@pytest.mark.parametrize(
    ("boxes", "room", "bearings"),
    [
        (PLATE, False, (0.3, 0.6, 0.9, 1.1, 1.3)),
        (PLATE, True, (0.6, 0.9, 1.1, 1.3)),
        (BOX, False, (0.3, 0.6, 0.9, 1.1)),
        (BOX, True, (0.6, 0.9, 1.1)),
    ],
    ids=["plate", "plate in a room", "box", "box in a room"],
)
def test_a_step_round_a_corner_is_predicted_as_registration_reports_it(
    boxes: tuple[Box, ...], room: bool, bearings: tuple[float, ...]
) -> None:
    """From the side the front is seen flat, and none of its edges is an edge any more."""
    front = np.array([[1.0, 0.0], [1.0, 0.1]])
    session = view_from(Session(CONFIG, 0, front, np.array([-1.0, 0.0])), boxes, Pose2(), room, 1)
    prediction = ErrorPrediction.of(PlanningContext(session))
    middle = (boxes[0].low[0] + boxes[0].high[0]) / 2
    for bearing in bearings:
        pose = Pose2(middle - 1.2 * math.cos(bearing), -1.2 * math.sin(bearing), bearing)
        expected = prediction.error(pose) / CONFIG.planning.calibration
        result = view_from(session, boxes, pose, room, 2).views[-1].registration
        assert result is not None
        assert result.converged
        assert 0.7 < expected / result.predicted_rmse < 2.2, bearing
