"""The quaternion of a mount against that of SciPy, which a run does without."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scan3d_twin.recording.mcap.ros_messages import _find_quaternion

TURNS = [
    *Rotation.random(200, rng=np.random.default_rng(0)),
    *Rotation.from_euler("xyz", np.array([[0, 0, 0], [180, 0, 0], [0, 180, 0], [0, 0, 180]]), True),
    *Rotation.from_euler("zyx", np.array([[90, 0, 0], [0, 90, 0], [0, 0, 90], [90, 90, 0]]), True),
]


def test_it_is_the_same_rotation_with_w_not_negative() -> None:
    for turn in TURNS:
        found = np.array(_find_quaternion(turn.as_matrix()))
        assert found[3] >= 0.0
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-12)
        assert Rotation.from_quat(found).as_matrix() == pytest.approx(turn.as_matrix(), abs=1e-12)
        if found[3] > 1e-9:  # else either sign is the same turn
            assert found == pytest.approx(turn.as_quat(canonical=True), abs=1e-12)
