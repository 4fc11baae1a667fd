from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from box_truth import FIRST, SECOND, BoxTruth, session_of

from scan3d_twin.core.model.evaluation import Reference, evaluate_model
from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.core.model.judged_targets import is_of_target
from scan3d_twin.core.types import FloatArray

pytestmark = pytest.mark.slow


def test_the_truth_is_about_its_own_target_only() -> None:
    session = session_of(FIRST)
    assert is_of_target(session, BoxTruth((FIRST,)))
    other = replace(session, hint=np.array([[0.6, 1.5], [0.6, 1.7]]))
    assert not is_of_target(other, BoxTruth((FIRST,)))


@pytest.mark.parametrize(("share", "scanned"), [(0.05, False), (0.2, True)])
def test_a_target_that_was_asked_for_may_be_a_part_of_what_was_scanned(share, scanned) -> None:
    """A hand is a part of its arm: where the robot takes them for one thing, it scans both."""
    session, count = session_of(FIRST), 100
    inside = np.arange(count) < share * count
    hint = np.where(inside[:, None], session.hint[0], session.hint[0] + (0.0, 3.0))
    mixed = replace(session, hint=hint)
    assert is_of_target(mixed, BoxTruth((FIRST,)), "target") == scanned
    assert not is_of_target(mixed, BoxTruth((FIRST,)))


@dataclass(frozen=True)
class TwoBoxes(BoxTruth):
    """The box, and a second one beside it."""

    gap: float = 0.5

    targets = ("near", "beside")

    def surface(
        self, spacing: float, targets: Sequence[str] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The four sides of each."""
        points, normals = super().surface(spacing)
        away = np.array([0.0, 0.8 + self.gap, 0.0])
        parts = {"near": points, "beside": points + away}
        chosen = self.targets if targets is None else targets
        return np.concatenate([parts[t] for t in chosen]), np.concatenate([normals] * len(chosen))


def test_the_target_that_was_scanned_counts_and_not_another_one() -> None:
    session = session_of(FIRST, SECOND)
    alone, two = BoxTruth((FIRST, SECOND)), TwoBoxes((FIRST, SECOND))
    model = build_model(session)
    result = evaluate_model(session, model, Reference.of(session, two))
    assert result.targets == ("near",)
    assert result.left_out == ("beside",)
    assert result.coverage == evaluate_model(session, model, Reference.of(session, alone)).coverage


def test_the_target_that_was_asked_for_counts_even_if_another_one_was_scanned() -> None:
    session, two = session_of(FIRST, SECOND), TwoBoxes((FIRST, SECOND))
    reference = Reference.of(session, two, "beside")
    result = evaluate_model(session, build_model(session), reference)
    assert result.targets == ("beside",)
    assert result.left_out == ()
    assert result.coverage < 0.05
    assert not result.is_success(math.inf)
    place = Reference.of(session, two, "0.6,0.0")
    assert place.targets == ("near",)
    assert place.left_out == ()


@pytest.mark.parametrize(("gap", "count"), [(0.15, 2), (0.3, 1)])
def test_targets_that_are_one_thing_to_the_robot_count_together(gap: float, count: int) -> None:
    session, two = session_of(FIRST, SECOND), TwoBoxes((FIRST, SECOND), gap=gap)
    for asked in ("", "near", "beside"):
        assert len(Reference.of(session, two, asked).targets) == count
