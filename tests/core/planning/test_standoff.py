"""The standoff by the height of the target in the first panorama."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.config import Config
from scan3d_twin.core.planning.standoff import choose_standoff, fit_standoff, measure_height
from scan3d_twin.core.types import FloatArray, Observation, Pose2

WINDOW = Config().target.window
LIDAR = 0.30


def looked_at(height: float, room: bool = True) -> tuple[Observation, FloatArray]:
    """Return a panorama of a box of this ``height`` [m], by default in a ``room``, and a hint."""
    box = Box((1.5, -0.2, 0.0), (1.9, 0.2, height))
    view = observe(Pose2(), (box,), room=room, width=math.tau - 1e-3, step=math.radians(2.0))
    hint = np.column_stack([np.full(21, 1.5), np.linspace(0.2, -0.2, 21)])
    return view, hint


@pytest.mark.parametrize("height", [0.1, 0.5, 1.6])
def test_the_panorama_shows_the_height(height: float) -> None:
    panorama, hint = looked_at(height)
    assert measure_height(panorama, hint, Config().target) == pytest.approx(height, abs=0.05)


def test_a_high_target_is_in_view_up_to_its_top() -> None:
    standoff = choose_standoff(1.0, 1.6, LIDAR, WINDOW)
    assert 1.6 < standoff < 1.9
    assert LIDAR + standoff * math.tan(WINDOW / 2) > 1.6
    assert choose_standoff(1.0, 3.0, LIDAR, WINDOW) == 2.0


@pytest.mark.parametrize("height", [0.25, 0.5, 1.0, math.nan])
def test_others_keep_the_configured_standoff(height: float) -> None:
    assert choose_standoff(1.0, height, LIDAR, WINDOW) == 1.0
    assert choose_standoff(1.3, height, LIDAR, WINDOW) == 1.3


def test_the_top_of_a_low_target_is_seen_from_nearer() -> None:
    standoff = choose_standoff(1.0, 0.1, LIDAR, WINDOW)
    assert 0.6 <= standoff < 0.8
    assert choose_standoff(0.5, 0.1, LIDAR, WINDOW) == 0.5
    assert choose_standoff(1.0, 0.2, LIDAR, WINDOW) == 1.0


def test_the_rule_is_an_option() -> None:
    panorama, hint = looked_at(1.6)
    assert fit_standoff(Config(), panorama, hint).planning.standoff > 1.4
    fixed = replace(Config(), planning=replace(Config().planning, standoff_rule="fixed"))
    assert fit_standoff(fixed, panorama, hint) is fixed
    paper = paper_config()
    assert fit_standoff(paper, panorama, hint) is paper


def test_a_target_that_no_reading_is_near_keeps_the_standoff() -> None:
    panorama, hint = looked_at(1.6, room=False)
    away = hint - np.array([0.8, 0.0])
    assert math.isnan(measure_height(panorama, away, Config().target))
    assert fit_standoff(Config(), panorama, away) == Config()
