"""Set cover as an integer program: the fewest views that see enough of a surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

MAX_NODES = 2000
"""Search nodes after which the solver returns the best cover it has found; a time limit would make
two runs of one seed differ."""
OPTIMALITY_GAP = 0.02
"""Relative gap at which a cover counts as optimal: less than one view of fifty."""


Sparse = Any
"""A sparse array of SciPy, which has no precise types."""


@dataclass(frozen=True)
class Cover:
    """A set-cover problem.

    Attributes:
        sees: Which view sees which piece (views, pieces).
        weights: Weights of the pieces (pieces,).
        needed: Weight to be covered.
        cost: Small extra cost of each view, beside its cost of 1 (views,).
        gap: Relative excess of the cost over the minimum that is allowed.
    """

    sees: BoolArray
    weights: FloatArray
    needed: float
    cost: FloatArray
    gap: float = OPTIMALITY_GAP


def solve_set_cover(cover: Cover) -> IntArray | None:
    """Return the views of a smallest cover, ascending; None if all views do not cover enough.

    It minimises sum_v (1 + c_v) x_v subject to y_p <= sum of x_v over the views v that see p,
    w . y >= needed, x binary and 0 <= y <= 1.
    """
    x = solve_program(cover, [], np.zeros(0))
    return None if x is None else np.flatnonzero(x[: len(cover.sees)] > 0.5)


def solve_chain_cover(cover: Cover, follows: BoolArray, starts: BoolArray) -> IntArray | None:
    """Return the views of a smallest cover that form a chain, in order; None if there is none.

    Args:
        cover: The problem, with the views in the order in which the robot passes them.
        follows: Whether the second of two views may follow the first (views, views); only the
            part above the diagonal counts, so that a chain is a path in a graph without cycles.
        starts: Whether a view may be the first (views,).

    A binary flow runs from a source through the chosen views to a sink: one in, one out of each.
    """
    # Number the flows
    n = len(cover.sees)
    a, b = np.nonzero(np.triu(follows, 1))
    first = np.flatnonzero(starts)
    flows = len(a) + len(first) + n

    # Balance them at each view
    into = _build_incidence(np.concatenate([b, first]), np.arange(len(a) + len(first)), (n, flows))
    out_flows = np.concatenate([np.arange(len(a)), np.arange(flows - n, flows)])
    out = _build_incidence(np.concatenate([a, np.arange(n)]), out_flows, (n, flows))
    views: Sparse = sparse.eye_array(n)
    source = np.zeros((1, flows))
    source[0, len(a) : len(a) + len(first)] = 1.0

    # Solve with one source
    rows: Rows = [
        (views, -into, 0.0),
        (views, -out, 0.0),
        (sparse.csr_array((1, n)), sparse.csr_array(source), 1.0),
    ]
    x = solve_program(cover, rows, np.ones(flows))
    return None if x is None else np.flatnonzero(x[:n] > 0.5)


Rows = list[tuple[Sparse, Sparse, float]]
"""Linear equations: coefficients of the views and of the flows, and the right side."""


def solve_program(cover: Cover, rows: Rows, flows: FloatArray) -> FloatArray | None:
    """Return the views, flows and pieces of a smallest cover with additional equations, or None."""
    # Imported on demand, as it takes half a second and 20 MB that other runs should not pay.
    from scipy.optimize import Bounds, LinearConstraint, milp

    # State what views cover
    sees, weights = _group_pieces(cover)
    n, m, p = len(sees), len(flows), len(weights)
    objective = np.concatenate([1.0 + cover.cost, np.zeros(m + p)])
    parts: list[Sparse] = [sees.T.astype(float), sparse.csr_array((p, m)), -np.eye(p)]
    seen: Sparse = sparse.hstack([sparse.csr_array(part) for part in parts])
    enough = np.concatenate([np.zeros(n + m), weights])[None]

    # Constrain pieces, weight and flows
    constraints = [
        LinearConstraint(sparse.csr_array(seen), lb=0.0, ub=np.inf),
        LinearConstraint(enough, lb=min(cover.needed, float(weights.sum())), ub=np.inf),
    ]
    for left, right, total in rows:
        both: Sparse = sparse.hstack([left, right, sparse.csr_array((left.shape[0], p))])
        constraints.append(LinearConstraint(sparse.csr_array(both), lb=total, ub=total))

    # Solve the integer program
    found = milp(
        objective,
        integrality=np.concatenate([np.ones(n + m), np.zeros(p)]),
        bounds=Bounds(0.0, 1.0),
        constraints=constraints,
        options={"node_limit": MAX_NODES, "mip_rel_gap": cover.gap},
    )
    return None if found.x is None else np.asarray(found.x)


def _group_pieces(cover: Cover) -> tuple[BoolArray, FloatArray]:
    """Return the pieces of ``cover`` grouped by the views that see them, without unseen ones."""
    patterns, index = np.unique(cover.sees, axis=1, return_inverse=True)
    weights = np.bincount(index.ravel(), cover.weights, patterns.shape[1]).astype(np.float64)
    some = patterns.any(axis=0)
    return patterns[:, some], weights[some]


def _build_incidence(rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> Sparse:
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)
