"""The planners that choose an overlap by a rule: fixed, pito, curvature."""

from __future__ import annotations

import numpy as np
import pytest
from sessions import PILASTERS, WALL, session_at, with_baselines

from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.planners.curvature import score_features
from scan3d_twin.core.planning.planners.pito import measure_resampled_area
from scan3d_twin.core.planning.surface.surface_patches import Eye, Patches, extract_view_patches
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2


@pytest.fixture(scope="module")
def wall() -> Session:
    """Return a session in front of a bare wall."""
    return session_at(WALL)


@pytest.fixture(scope="module")
def pilasters() -> Session:
    """Return a session in front of a wall with pilasters."""
    return session_at(PILASTERS)


def plan(name: str, session: Session, **changes: object) -> Plan:
    """Return the plan of the planner ``name`` with changed options."""
    return make_planner(name).plan(with_baselines(session, **changes), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "overlap"), [("fixed20", 0.2), ("fixed50", 0.5), ("fixed80", 0.8)]
)
def test_fixed_overlaps_by_name(name: str, overlap: float, wall: Session) -> None:
    assert plan(name, wall).overlap == overlap


def test_the_fixed_overlap_is_an_option_and_a_larger_one_is_a_shorter_step(wall: Session) -> None:
    plans = [plan("fixed", wall, fixed_overlap=overlap) for overlap in (0.3, 0.6)]
    assert [p.overlap for p in plans] == [0.3, 0.6]
    steps = [Pose2().distance(p.viewpoint) for p in plans if p.viewpoint]
    assert steps[0] > steps[1] > 0.1


def test_pito_takes_the_smallest_overlap_that_resamples_enough(wall: Session) -> None:
    plans = [plan("pito", wall, resampled_area=share) for share in (0.1, 0.3, 0.5)]
    etas = [p.overlap for p in plans]
    assert etas == sorted(etas)
    assert etas[0] < etas[-1]
    context = PlanningContext(wall)
    eye, current = Eye.of(context.view, wall.config), extract_view_patches(context.view)
    for share, p in zip((0.1, 0.3, 0.5), plans, strict=True):
        assert p.viewpoint is not None
        assert measure_resampled_area(current, p.viewpoint, eye) >= share


def test_pito_falls_back_when_nothing_resamples_enough(wall: Session) -> None:
    assert plan("pito", wall, resampled_area=1.0).overlap == wall.config.planning.default_overlap


def test_resampled_area_is_everything_from_the_same_place_and_nothing_from_behind(
    wall: Session,
) -> None:
    context = PlanningContext(wall)
    eye, current = Eye.of(context.view, wall.config), extract_view_patches(context.view)
    same = measure_resampled_area(current, Pose2(), eye)
    assert 0.8 < same <= 1.0
    assert measure_resampled_area(current, Pose2(2.0, 0.0, np.pi), eye) == 0.0


@pytest.mark.parametrize("feature", ["normals", "variation"])
def test_curvature_steps_farther_over_features(
    feature: str, wall: Session, pilasters: Session
) -> None:
    bare, rich = (plan("curvature", s, feature=feature) for s in (wall, pilasters))
    assert bare.overlap == 0.8
    assert "too few features" in bare.reason
    assert rich.overlap < 0.8


def test_the_feature_score_of_known_surfaces() -> None:
    flat, corner = np.tile([1.0, 0.0, 0.0], (10, 1)), np.tile([0.0, 1.0, 0.0], (10, 1))
    points, none = np.zeros((20, 3)), np.zeros(20)
    both = Patches(points, np.concatenate([flat, corner]), none)
    assert score_features(both, 20, "normals") == pytest.approx(0.5)
    assert score_features(both, 40, "normals") == pytest.approx(0.25)
    assert score_features(Patches(points[:10], flat, none[:10]), 20, "normals") == 0.0
    bent = Patches(points, both.normals, np.repeat([0.2, 0.001], 10))
    assert score_features(bent, 20, "variation") == pytest.approx(0.5)
