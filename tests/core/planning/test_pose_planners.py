"""The planners that choose a pose: random, frontier2d, ig, see, roberts, oracle."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config
from sessions import BOX, WALL, session_at, with_baselines

from scan3d_twin.core.planning import make_planner
from scan3d_twin.core.planning.candidates.pose_candidates import (
    MAX_STANDOFFS,
    MIN_STANDOFFS,
    PoseCandidates,
)
from scan3d_twin.core.planning.planners.ig import compute_gain, compute_utility, rate_share
from scan3d_twin.core.planning.planners.see import find_frontier
from scan3d_twin.core.planning.surface.voxels import FREE, OCCUPIED, UNKNOWN, Rays, VoxelMap
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2
from scan3d_twin.core.viewpoints import MAX_FRONT_ANGLE

pytestmark = pytest.mark.slow

NAMES = ("random", "frontier2d", "ig", "see", "roberts")


@pytest.fixture(scope="module")
def box() -> Session:
    """A box seen from its front; the tour goes all round."""
    return session_at(BOX, paper_config(tour="full"), half=0.3)


@pytest.fixture(scope="module")
def wall() -> Session:
    """Return a session in front of a bare wall."""
    return session_at(WALL)


def plan(name: str, session: Session, seed: int = 0, **changes: object) -> Plan:
    """Return the plan of the planner ``name`` with changed options."""
    return make_planner(name).plan(with_baselines(session, **changes), np.random.default_rng(seed))


def test_candidates_are_feasible_new_and_at_the_standoff(box: Session) -> None:
    candidates = PoseCandidates.of(box)
    assert len(candidates.poses) > 10
    assert np.all(np.isfinite(candidates.travel))
    for pose in candidates.poses:
        assert candidates.context.is_feasible(pose)  # world and scan are one frame here
        assert pose.distance(Pose2()) > 0.15 or abs(pose.yaw) > math.radians(15)
    place = np.array([[pose.x, pose.y] for pose in candidates.poses])
    nearest = np.min(
        np.linalg.norm(place[:, None] - candidates.surface.points[None, :, :2], axis=2), axis=1
    )
    assert nearest.min() >= MIN_STANDOFFS - 1e-9
    assert nearest.max() <= MAX_STANDOFFS + 1e-9


def test_a_tour_of_the_front_stays_there(wall: Session) -> None:
    for pose in PoseCandidates.of(wall).poses:
        assert abs(pose.yaw) <= MAX_FRONT_ANGLE + 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_plans_are_pure_and_feasible(name: str, box: Session) -> None:
    first, again = (plan(name, box) for _ in range(2))
    assert first == again
    assert first.viewpoint is not None
    assert PoseCandidates.of(box).context.is_feasible(first.viewpoint)
    assert first.candidates[-1].viewpoint == first.viewpoint
    assert 0.0 <= first.overlap <= 1.0
    assert first.reason


@pytest.mark.parametrize("name", ["frontier2d", "ig", "roberts"])
def test_the_next_view_shows_what_was_not_seen(name: str, box: Session) -> None:
    viewpoint = plan(name, box).viewpoint
    candidates = PoseCandidates.of(box)
    assert viewpoint is not None
    chosen = candidates.poses.index(viewpoint)
    assert candidates.new_area[chosen] >= box.config.baselines.min_new_area


@pytest.mark.parametrize("gain_of", ["oa", "rse", "af"])
def test_every_gain_leads_somewhere_new(gain_of: str, box: Session) -> None:
    chosen = plan("ig", box, gain=gain_of)
    assert chosen.viewpoint is not None
    assert gain_of in chosen.reason


def test_random_views_differ_by_the_generator_alone(box: Session) -> None:
    drawn = {plan("random", box, seed).viewpoint for seed in range(4)}
    assert len(drawn) > 1


def test_gonzalez_banos_wants_to_see_known_edges_again(box: Session) -> None:
    near = plan("frontier2d", box, frontier="gonzalez-banos", min_solid_edge=0.4)
    assert near.overlap > 0.2
    none = plan("frontier2d", box, frontier="gonzalez-banos", min_solid_edge=50.0)
    assert none.viewpoint is None


@pytest.mark.parametrize("name", NAMES)
def test_the_end_is_announced_after_a_look_around(name: str, box: Session) -> None:
    blind = replace(box, panoramas=box.panoramas[:1])
    ended = plan(name, blind, min_new_area=1e3)
    if name != "see":  # which goes by the cloud, not by the space
        assert ended.viewpoint is None
        assert ended.needs_panorama
        assert plan(name, box, min_new_area=1e3).reason == "full complete: nothing new in sight"


@pytest.mark.parametrize("name", NAMES)
def test_max_views_end_the_run(name: str, box: Session) -> None:
    session = replace(box, config=replace(box.config, max_views=1))
    assert plan(name, session).reason == "1 view taken (max_views)"


def test_the_frontier_of_a_wall_is_where_the_sweep_ended(wall: Session) -> None:
    frontier = find_frontier(wall)
    y = frontier.patches.points[:, 1]
    assert len(frontier) > 4
    assert np.mean(np.abs(np.abs(y) - 0.55) < 0.12) > 0.9
    assert np.all(frontier.patches.normals[:, 0] < -0.9)
    assert np.mean(np.sign(frontier.onwards[:, 1]) == np.sign(y)) > 0.9


def test_see_looks_at_a_frontier_along_its_normal(wall: Session) -> None:
    viewpoint = plan("see", wall).viewpoint
    assert viewpoint is not None
    assert abs(viewpoint.x) < 0.1  # at the standoff of 1 m
    assert abs(viewpoint.y) == pytest.approx(0.5, abs=0.2)
    assert abs(viewpoint.yaw) < 0.2


def rays(*labels: int) -> tuple[Rays, VoxelMap]:
    """Return one ray through a row of voxels."""
    row = np.array(labels, dtype=np.int8)
    space = VoxelMap(np.zeros(3), row.reshape(-1, 1, 1), row.reshape(-1, 1, 1) == OCCUPIED)
    return Rays(np.arange(len(row))[None], row[None]), space


def test_gains_of_known_rays() -> None:
    H, free = math.log(2.0), 1 - 0.1192
    two, space = rays(UNKNOWN, UNKNOWN)
    assert compute_gain(two, space, "oa") == pytest.approx(H + 0.5 * H)
    assert compute_gain(two, space, "rse") == 0.0
    rear, space = rays(FREE, UNKNOWN, OCCUPIED)
    assert compute_gain(rear, space, "rse") == pytest.approx(free * H)
    broken, space = rays(UNKNOWN, FREE, OCCUPIED)
    assert compute_gain(broken, space, "rse") == 0.0


def test_the_area_factor_wants_a_fifth_of_overlap() -> None:
    assert rate_share(0.0, 0.2) == 0.0
    assert rate_share(0.2, 0.2) == pytest.approx(1.0)
    assert rate_share(0.2 + 1e-12, 0.2) == pytest.approx(1.0)
    assert rate_share(1.0, 0.2) == pytest.approx(0.0, abs=1e-12)
    assert rate_share(0.1, 0.2) == pytest.approx(0.5)
    values = [rate_share(x, 0.8) for x in np.linspace(0, 1, 101)]
    assert int(np.argmax(values)) == 80


def test_utility_trades_gain_for_travel() -> None:
    gains, travel = np.array([3.0, 2.9]), np.array([3.0, 0.5])
    assert np.argmax(compute_utility(gains, travel, 0.0)) == 0
    assert np.argmax(compute_utility(gains, travel, 0.5)) == 1
