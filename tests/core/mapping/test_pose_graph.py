"""The pose graph against poses that are known, and its algebra against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.mapping.pose_graph import (
    PoseGraph,
    Solution,
    ad,
    adjoint,
    compose,
    exp,
    inverse,
    log,
)
from scan3d_twin.core.types import FloatArray, Pose2

RING = [Pose2(math.cos(a), math.sin(a), a + math.pi) for a in np.arange(12) * math.tau / 12]
TRUE = [RING[0].inverse() @ pose for pose in RING]
SIGMAS = np.array([0.003, 0.005, 0.002])
INFORMATION = np.diag(1.0 / SIGMAS**2)

motions = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3.1, 3.1)).map(np.array)


def rows(poses: list[Pose2]) -> FloatArray:
    """Return ``poses`` as rows x, y, yaw (n, 3)."""
    return np.array([[p.x, p.y, p.yaw] for p in poses])


def noisy(rng: np.random.Generator, i: int, j: int) -> Pose2:
    """Return T_i_j with an error of ``SIGMAS`` about i's origin."""
    error = Pose2(*exp((SIGMAS * rng.standard_normal(3))[None])[0])
    return error @ TRUE[i].inverse() @ TRUE[j]


def ring(seed: int, wrong: Pose2 | None = None) -> tuple[list[Pose2], Solution]:
    """Return the chain of a ring of neighbours and next neighbours, and the graph's solution."""
    rng = np.random.default_rng(seed)
    edges = [(i, (i + k) % 12, noisy(rng, i, (i + k) % 12)) for i in range(12) for k in (1, 2)]
    if wrong is not None:
        edges[10] = (*edges[10][:2], wrong @ edges[10][2])
    chain = [Pose2()]
    for i in range(11):
        chain.append(chain[-1] @ edges[2 * i][2])
    graph = PoseGraph(chain)
    for i, j, T in edges:
        graph.add_edge(i, j, T, INFORMATION)
    return chain, graph.optimize()


def deviation(poses: tuple[Pose2, ...]) -> FloatArray:
    """Return by how much poses lie off the truth, along their own axes (3 n,)."""
    return log(compose(inverse(rows(TRUE)), rows(list(poses)))).reshape(-1)


@given(motions)
def test_log_undoes_exp(d: FloatArray) -> None:
    assert log(exp(d[None]))[0] == pytest.approx(d, abs=1e-9)


@given(motions, motions)
def test_the_adjoint_moves_a_motion_to_the_other_side(T: FloatArray, d: FloatArray) -> None:
    pose, small = exp(T[None]), 1e-3 * d[None]
    left = compose(pose, exp(small))
    right = compose(exp(np.einsum("nij,nj->ni", adjoint(pose), small)), pose)
    assert log(compose(left, inverse(right)))[0] == pytest.approx(np.zeros(3), abs=1e-9)


@given(motions, motions)
def test_ad_is_the_derivative_of_the_adjoint(a: FloatArray, b: FloatArray) -> None:
    h = 1e-6
    numeric = (adjoint(exp(h * a[None])) - adjoint(exp(-h * a[None])))[0] @ b / (2 * h)
    assert ad(a[None])[0] @ b == pytest.approx(numeric, abs=1e-6)


def test_exact_edges_bring_any_start_to_the_truth() -> None:
    rng = np.random.default_rng(0)
    graph = PoseGraph(
        [TRUE[0], *(Pose2(*exp(0.3 * rng.standard_normal((1, 3)))[0]) @ p for p in TRUE[1:])]
    )
    for i in range(12):
        graph.add_edge(i, (i + 1) % 12, TRUE[i].inverse() @ TRUE[(i + 1) % 12], INFORMATION)
    solution = graph.optimize()
    assert deviation(solution.poses) == pytest.approx(np.zeros(36), abs=1e-6)
    assert np.all(solution.chi2 < 1e-6)
    assert np.all(solution.weights > 0.999)


def test_the_covariance_is_that_of_many_graphs() -> None:
    normal = []
    for seed in range(40):
        _, solution = ring(seed)
        d = deviation(solution.poses)[3:]
        normal.append(d @ np.linalg.inv(solution.covariance[3:, 3:]) @ d / 33)
    assert 0.85 < float(np.mean(normal)) < 1.15


def test_loops_repair_a_chain() -> None:
    before, after = [], []
    for seed in range(10):
        chain, solution = ring(seed)
        before.append(np.abs(deviation(tuple(chain))).max())
        after.append(np.abs(deviation(solution.poses)).max())
    assert np.median(after) < 0.6 * np.median(before)


@settings(max_examples=10, deadline=None)
@given(st.floats(10 * SIGMAS.max(), 0.3), st.floats(-math.pi, math.pi))
def test_one_wrong_link_of_the_chain_is_overruled(length: float, bearing: float) -> None:
    # Weighed below .05 from 7.5 standard deviations; the link's own noise takes up to 2.5 off.
    slip = Pose2(length * math.cos(bearing), length * math.sin(bearing))
    _, solution = ring(3, wrong=slip)
    assert solution.weights[10] < 0.05
    assert np.all(np.delete(solution.weights, 10) > 0.3)
    assert np.abs(deviation(solution.poses)).max() < 0.012


def test_a_weak_direction_is_left_to_who_knows_it() -> None:
    graph = PoseGraph([Pose2(), Pose2(1.0, 0.1)])
    graph.add_edge(0, 1, Pose2(1.0, 0.1), np.diag([1.0, 1.0, 1.0]), robust=False)
    graph.add_edge(0, 1, Pose2(0.5, 0.3), np.diag([0.0, 1e6, 1e6]))
    solution = graph.optimize()
    assert solution.poses[1].x == pytest.approx(1.0, abs=1e-3)
    assert solution.poses[1].y == pytest.approx(0.3, abs=1e-3)


def test_relative_is_what_an_edge_says() -> None:
    graph = PoseGraph([Pose2(), Pose2(1.0, 0.0, 1.0)])
    C = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, 0.2], [0.5, 0.2, 2.0]]) * 1e-4
    graph.add_edge(0, 1, Pose2(1.0, 0.0, 1.0), np.linalg.inv(C))
    T, found = graph.optimize().relative(0, 1)
    assert (T.x, T.y, T.yaw) == pytest.approx((1.0, 0.0, 1.0))
    assert found == pytest.approx(C, rel=1e-6)


def test_the_same_edges_give_the_same_bits() -> None:
    assert ring(5)[1].covariance.tobytes() == ring(5)[1].covariance.tobytes()
    assert ring(5)[1].poses == ring(5)[1].poses


@pytest.mark.parametrize(
    ("i", "j", "information", "message"),
    [
        (0, 0, np.eye(3), "no edge"),
        (0, 5, np.eye(3), "no edge"),
        (0, 1, np.eye(2), r"\(3, 3\)"),
        (0, 1, np.full((3, 3), np.nan), "finite"),
        (0, 1, np.diag([1.0, -1.0, 1.0]), "negative"),
    ],
)
def test_an_impossible_edge_is_refused(
    i: int, j: int, information: FloatArray, message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        PoseGraph([Pose2(), Pose2()]).add_edge(i, j, Pose2(), information)


def test_a_view_without_edges_is_refused() -> None:
    graph = PoseGraph([Pose2(), Pose2(), Pose2()])
    graph.add_edge(0, 1, Pose2(), INFORMATION)
    with pytest.raises(ConfigError, match="free to move"):
        graph.optimize()
