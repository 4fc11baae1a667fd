"""A place per line in a slice, and where the target ends in it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sessions import BOX, session_at
from synthetic import Box

from scan3d_twin.core.planning.candidates.profiles import Edge, Profile, _find_ranked
from scan3d_twin.core.types import FloatArray, Pose2

GAP = (Box((1.0, 0.05, 0.0), (1.4, 0.6, 0.6)), Box((1.0, -0.6, 0.0), (1.4, -0.05, 0.6)))
"""Two boxes beside each other with a gap of 0.1 m."""
BESIDE = Pose2(0.3, 1.0, math.radians(-40.0))


def seen(boxes: tuple[Box, ...], pose: Pose2, sigma: float = 0.004, seed: int = 4) -> Profile:
    """Return the profile of a view from ``pose`` at the height of the lidar."""
    view = session_at(boxes, poses=(pose,), sigma=sigma, seed=seed).views[-1]
    return Profile.through(view, [0.30], 0.15)[0]


def in_world(profile: Profile, pose: Pose2) -> list[Edge]:
    """Return the edges from the left to the right of the front."""
    edges = [edge.seen_from(pose) for edge in profile.edges]
    return sorted(edges, key=lambda edge: -float(edge.place[1]))


def test_a_place_is_known_better_than_a_reading() -> None:
    profile = seen(BOX, Pose2(), sigma=0.010)
    off = profile.places[profile.on_target, 0] - 0.9
    assert len(off) > 50
    assert np.std(off) < 0.010 / 3


@pytest.mark.parametrize("seed", range(10))
def test_both_ends_of_a_front_are_found_whatever_the_noise(seed: int) -> None:
    left, right = in_world(seen(BOX, Pose2(), sigma=0.008, seed=seed), Pose2())
    for edge, y, onwards in ((left, 0.3, 1.0), (right, -0.3, -1.0)):
        assert edge.place == pytest.approx([0.9, y], abs=0.015)
        assert edge.normal == pytest.approx([-1.0, 0.0], abs=0.06)
        assert edge.onwards == pytest.approx([0.0, onwards], abs=0.06)
        assert edge.spacing < 0.012


@pytest.mark.parametrize("seed", range(10))
def test_a_gap_is_found_in_an_oblique_sight(seed: int) -> None:
    """Of 10 cm, from 45 deg: the near side of it alone shows as an end."""
    edges = in_world(seen(GAP, BESIDE, sigma=0.008, seed=seed), BESIDE)
    places = [edge.place for edge in edges if edge.normal[0] < -0.9]
    assert any(place == pytest.approx([1.0, 0.05], abs=0.03) for place in places)


def with_line(profile: Profile, line: int, away: float) -> Profile:
    """Return ``profile`` with the place of a line moved to a distance [m]."""
    places = np.array(profile.places)
    places[line] *= away / np.linalg.norm(places[line])
    return Profile(places, profile.on_target)


def distances(profile: Profile) -> FloatArray:
    """Return how far the places are (n_lines,) [m]."""
    return np.linalg.norm(profile.places, axis=1)


def test_a_line_half_on_the_surface_hides_no_edge() -> None:
    """As mixed pixels make them: between the surface and what is behind it."""
    profile = seen(GAP, Pose2(0.0, -0.3, 0.0))
    away = distances(profile)
    last = int(np.flatnonzero(np.abs(away[1:] - away[:-1]) > 0.2)[0])
    for share in (0.2, 0.5, 0.8):
        line = last + 1
        between = with_line(profile, line, away[last] + share * (away[line] - away[last]))
        assert len(list(between.edges)) == len(list(profile.edges))


def test_lines_at_an_end_are_no_surface() -> None:
    profile = seen(BOX, Pose2())
    near = np.flatnonzero(distances(profile) < 1.0)
    assert not profile.on_target[[near[0], near[-1]]].any()
    assert profile.on_target[near[1:-1]].all()


def test_what_goes_on_steeply_does_not_end() -> None:
    """A wall that recedes by 7 cm a line at the end of the sweep."""
    wall = (Box((0.5, -6.0, 0.0), (0.7, 0.5, 1.5)),)
    assert all(edge.place[1] > 0.4 for edge in in_world(seen(wall, Pose2()), Pose2()))


def test_no_edge_is_told_where_lines_are_far_apart() -> None:
    far = Pose2(0.3, 2.2, math.radians(-65.0))
    assert all(edge.spacing <= 0.03 for edge in seen(GAP, far).edges)
    assert not any(edge.place[1] < 0.0 for edge in in_world(seen(GAP, far), far))


@pytest.mark.parametrize("radius", [0.2, 0.4])
def test_the_outline_of_a_curved_body_is_no_edge(radius: float) -> None:
    yaws = np.radians(np.arange(40.0, -40.0, -0.5))
    middle = 1.0 + radius
    below = radius**2 - (middle * np.sin(yaws)) ** 2
    away = middle * np.cos(yaws) - np.sqrt(np.where(below > 0, below, np.nan))
    places = away[:, None] * np.column_stack([np.cos(yaws), np.sin(yaws)])
    assert list(Profile(places, np.isfinite(away)).edges) == []


def test_a_slice_without_readings_has_no_places() -> None:
    view = session_at(BOX).views[-1]
    profile = Profile.through(view, [3.0], 0.15)[0]
    assert not profile.on_target.any()
    assert list(profile.edges) == []


def test_the_reading_of_a_rank_is_found_without_sorting_empty_beams() -> None:
    values = np.random.default_rng(0).random((30, 40))
    values[:, 5:20] = np.inf
    values[7] = np.inf
    ranks = np.arange(30) % 20
    found = _find_ranked(values, ranks)
    assert np.array_equal(np.delete(found, 7), np.delete(np.argsort(values)[range(30), ranks], 7))
    assert np.array_equal(_find_ranked(np.full((2, 3), np.inf), np.zeros(2, int)), [0, 0])
