"""Set cover as an integer program: the fewest views that see enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from scan3d_twin.core.types import BoolArray, FloatArray, IntArray

NODES = 2000
"""Nodes after which the search returns the best cover found so far: a limit of time would make two
runs of one seed differ."""
EXACT = 0.02
"""Less than one view of fifty is optimal, since views are whole numbers."""


Sparse = Any
"""A sparse array of SciPy, whose types say little."""


@dataclass(frozen=True)
class Cover:
    """What there is to cover.

    Attributes:
        sees: Which view sees which piece (views, pieces).
        weights: Of the pieces (pieces,).
        needed: Weight to be covered.
        cost: Of each view beside the one for being a view; small (views,).
        gap: Share by which the cost may exceed the least.
    """

    sees: BoolArray
    weights: FloatArray
    needed: float
    cost: FloatArray
    gap: float = EXACT


def fewest(cover: Cover) -> IntArray | None:
    """Return the views of a smallest cover, ascending; None if all together do not cover enough.

    min sum x_v + c_v x_v with y_p <= sum over the views of p of x_v, w y >= needed, x binary,
    0 <= y <= 1.
    """
    x = solve(cover, [], np.zeros(0))
    return None if x is None else np.flatnonzero(x[: len(cover.sees)] > 0.5)


def fewest_chain(cover: Cover, follows: BoolArray, starts: BoolArray) -> IntArray | None:
    """Return the views of a smallest cover that form a chain, in order; None if there is none.

    Args:
        cover: With the views in the order in which the robot passes them.
        follows: Whether the second of two views may follow the first (views, views); only the
            part above the diagonal counts, so that a chain is a path in a graph without cycles.
        starts: Whether a view may be the first (views,).

    Binary flows f run from a source through the views taken to a sink, one in and one out.
    """
    n = len(cover.sees)
    a, b = np.nonzero(np.triu(follows, 1))
    first = np.flatnonzero(starts)
    flows = len(a) + len(first) + n
    into = _incidence(np.concatenate([b, first]), np.arange(len(a) + len(first)), (n, flows))
    out_flows = np.concatenate([np.arange(len(a)), np.arange(flows - n, flows)])
    out = _incidence(np.concatenate([a, np.arange(n)]), out_flows, (n, flows))
    views: Sparse = sparse.eye_array(n)
    source = np.zeros((1, flows))
    source[0, len(a) : len(a) + len(first)] = 1.0
    rows: Rows = [
        (views, -into, 0.0),
        (views, -out, 0.0),
        (sparse.csr_array((1, n)), sparse.csr_array(source), 1.0),
    ]
    x = solve(cover, rows, np.ones(flows))
    return None if x is None else np.flatnonzero(x[:n] > 0.5)


Rows = list[tuple[Sparse, Sparse, float]]
"""Equations: coefficients of the views and of the flows, and their sum."""


def solve(cover: Cover, rows: Rows, flows: FloatArray) -> FloatArray | None:
    """Return the views, flows and pieces of a smallest cover under more constraints, or None."""
    # Loaded when a planner needs it: half a second and 20 MB that no other run should pay.
    from scipy.optimize import Bounds, LinearConstraint, milp

    sees, weights = _grouped(cover)
    n, m, p = len(sees), len(flows), len(weights)
    objective = np.concatenate([1.0 + cover.cost, np.zeros(m + p)])
    parts: list[Sparse] = [sees.T.astype(float), sparse.csr_array((p, m)), -np.eye(p)]
    seen: Sparse = sparse.hstack([sparse.csr_array(part) for part in parts])
    enough = np.concatenate([np.zeros(n + m), weights])[None]
    constraints = [
        LinearConstraint(sparse.csr_array(seen), lb=0.0, ub=np.inf),
        LinearConstraint(enough, lb=min(cover.needed, float(weights.sum())), ub=np.inf),
    ]
    for left, right, total in rows:
        both: Sparse = sparse.hstack([left, right, sparse.csr_array((left.shape[0], p))])
        constraints.append(LinearConstraint(sparse.csr_array(both), lb=total, ub=total))
    found = milp(
        objective,
        integrality=np.concatenate([np.ones(n + m), np.zeros(p)]),
        bounds=Bounds(0.0, 1.0),
        constraints=constraints,
        options={"node_limit": NODES, "mip_rel_gap": cover.gap},
    )
    return None if found.x is None else np.asarray(found.x)


def _grouped(cover: Cover) -> tuple[BoolArray, FloatArray]:
    """Return the cover with pieces that the same views see as one, and without those none sees."""
    patterns, index = np.unique(cover.sees, axis=1, return_inverse=True)
    weights = np.bincount(index.ravel(), cover.weights, patterns.shape[1]).astype(np.float64)
    some = patterns.any(axis=0)
    return patterns[:, some], weights[some]


def _incidence(rows: IntArray, columns: IntArray, shape: tuple[int, int]) -> Sparse:
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)
