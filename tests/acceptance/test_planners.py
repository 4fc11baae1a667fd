"""Planners of each kind in the closed loop on the twin, for a few views."""

from __future__ import annotations

import dataclasses

import pytest

from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.digitize import run_loop
from scan3d_twin.core.model.evaluation import evaluate
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.session import Session
from scan3d_twin.run.settings import build_settings
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

RIVALS = ("frontier2d", "pito", "see")


def config(tour: str, **changes: object) -> Config:
    own = build_settings([{"tour": tour}, preset_options("best")]).config
    return dataclasses.replace(own, **changes)  # type: ignore[arg-type]


def run(name: str, max_views: int) -> tuple[Session, float]:
    """Digitise the front of the three boxes; return the session and the coverage."""
    scene = load_scene("three_boxes")
    effective = config(scene.tour, max_views=max_views)
    with open_sim(scene, 3) as (robot, truth):
        planner = make_planner(name, truth)
        session = run_loop(robot, planner, effective, 3, Unobserved())
        return session, evaluate(session, truth).coverage


@pytest.mark.parametrize("name", RIVALS)
def test_two_views_of_the_front(name: str) -> None:
    session, coverage = run(name, max_views=2)
    assert len(session.views) == 2
    assert all(plan.reason for plan in session.plans)
    assert all(plan.viewpoint is not None for plan in session.plans[:-1])
    assert coverage > 0.3


def test_the_oracle_needs_few_views() -> None:
    session, coverage = run("oracle", max_views=8)
    assert session.stop_reason.startswith("front complete")
    assert len(session.views) <= 5
    assert coverage > 0.85
