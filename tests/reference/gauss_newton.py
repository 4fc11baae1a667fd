"""Registration of two sweeps by Gauss-Newton, in NumPy: maximum a posteriori pose, covariance.

Gauss-Newton on the normal equations of ``point_to_plane``, with the gate and the robust weights
tightened from step to step, the odometry as prior about the viewpoint and vertical edges:

    (H_kept + H_edges + L0) step = -(g_kept + g_edges + L0 (x - x0)).

H_kept holds those eigenvectors v of the scans' information H whose information exceeds twice what
noise of the normals fakes, v^T H v >= 2 v^T H_faked v (Hatleskog and Alexis, arXiv 2410.10784): on
a wall the rest would be a slide that looks like knowledge, so it is left to prior and edges. Twice
means: as much signal as noise. Along the rest the data say nothing of the nuisances, either. The
covariance is the inverse of the left side, less what is spurious and what yaw jitter hides; for
point to plane that is sound (Bonnabel et al., arXiv 1410.7632).

The last step has the errors that readings share as unknowns: see ``shared_errors``. It is solved
once more with those of the patches as large as they turn out, and the others enlarged where they
turn out larger than usual.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from reference.algebra import (
    SIGNAL,
    State,
    block,
    determined,
    eliminated,
    inverse,
    picked,
    projected,
    quadratic,
    with_prior,
    without_directions,
)
from reference.edges import edge_sums
from reference.point_to_plane import (
    Gate,
    PairNoise,
    normal_equations,
)
from reference.pose_prior import (
    Moments,
    about_target,
    deviation,
    displaced,
    displacement,
)
from reference.scan_arrays import Sample, Target
from reference.shared_errors import shared_errors, state_prior, state_spread
from reference.stretched_windows import MOST_STRETCH, stretched
from scan3d_twin.core.types import FloatArray, read_only

Dof = Literal["planar", "se3"]
DAMPED_FROM = 15
"""Iteration from which on steps are halved."""
MIN_PAIRS = 12
"""Least number of correspondences for a reliable step."""
WANTED, WANTED_LAST = 3000, 12000
"""Surfels used of a source, and in the very last step: fewer lose accuracy where the surface bends,
as windows are small and overlap little there."""
TIGHTEN = 0.7
"""Factor on gate and kernel from one step to the next."""
LAST_GATE, LAST_ROBUST = 0.03, 1.5
"""Least gate [m], a few times the range noise, and least robust kernel [sigma]."""
FIRST_COSINE, LAST_COSINE = 0.4, 0.87
"""Between the normals of a pair, at which its weight is 0: 66 deg, 30 deg at the least gate."""
FIRST_ROBUST = 4.0
"""The kernel of the first step [sigma]."""
SAME_BASIN = 0.010
"""Poses that displace the source by less than this from each other are one basin [m]."""
USUAL_SPREAD = 0.77
"""Of the errors that all readings share, in assumed ones."""
MOST_SPREAD = 1.4
"""Of these errors, in usual ones, that is no larger than usual."""
EDGE_ROBUST = 2.0
"""The kernel of edges, in kernels of surfels: their errors are uniform, not normal."""


NOTHING = read_only(np.zeros((6, 6)))
"""Covariance that stands for no prior."""


class Criteria(NamedTuple):
    """Convergence criteria of the iteration, and its first gate."""

    max_iterations: int = 30
    translation_epsilon: float = 1e-4
    rotation_epsilon: float = 1e-4
    max_correspondence_distance: float = 0.10


class Scans(NamedTuple):
    """What the iteration needs of two grids.

    Attributes:
        target: What the source is laid on.
        coarse: Surfels of the source for the first steps.
        fine: For the steps at the last gate.
        every: For the one step after these have settled.
        target_edges: As rows (m, 8), see ``edges``.
        source_edges: As rows (n, 8).
        both: What the sweeps err by.
        moments: Of the source's surfels.
    """

    target: Target
    coarse: Sample
    fine: Sample
    every: Sample
    target_edges: FloatArray
    source_edges: FloatArray
    both: PairNoise
    moments: Moments


class Prior(NamedTuple):
    """Prior distribution of the pose and the yaw scale.

    Attributes:
        mean: Of ``T_target_source`` (4, 4).
        covariance: Of x y z rx ry rz (6, 6); 0 when nothing is known.
        rows: The estimated entries of these, k of them.
        yaw_scale: Information of the common relative error of the yaws; infinite when exact.
    """

    mean: FloatArray
    covariance: FloatArray
    rows: tuple[int, ...]
    yaw_scale: float


class Current(NamedTuple):
    """State of the iteration: ``T_target_source`` (4, 4) and the yaw scale error."""

    T: FloatArray
    scale: float


class Solution(NamedTuple):
    """One Gauss-Newton step and its equations.

    Attributes:
        step: Of x y z rx ry rz about the viewpoint (6,).
        scale_step: Of the yaw scale error.
        information: Left side of the equation, less what is spurious (k, k).
        dropped: Directions (j, k) that the surfels do not determine.
        edges: Information of the edges (k, k).
        pairs: Number of correspondences.
        patch_spread: Of the patches' errors, in assumed ones; NaN if not estimated.
        spread: Of the errors that all readings share, in usual ones.
    """

    step: FloatArray
    scale_step: float
    information: FloatArray
    dropped: FloatArray
    edges: FloatArray
    pairs: int
    patch_spread: float
    spread: float


class Knowledge(NamedTuple):
    """Covariance and information of ``T_target_source`` at the end, about the target's origin.

    Attributes:
        covariance: Of x y z rx ry rz (6, 6).
        information: Its inverse on the estimated entries (6, 6).
        degenerate: Directions (j, 6) that neither surfels nor edges determine.
        predicted_rmse: RMS displacement of the source's surfels to be expected [m].
    """

    covariance: FloatArray
    information: FloatArray
    degenerate: FloatArray
    predicted_rmse: float


class RunResult(NamedTuple):
    """Result of the iteration.

    Attributes:
        state: After the last step.
        solution: Of the last step.
        knowledge: What it leaves unknown.
        surfels: Of the source that took part in it.
        iterations: Steps in all.
        settled: Whether they became small enough.
        overlap: Whether enough surfels found a partner.
    """

    state: Current
    solution: Solution
    knowledge: Knowledge
    surfels: int
    iterations: int
    settled: bool
    overlap: bool


def descend(
    scans: Scans, prior: Prior, criteria: Criteria, starts: FloatArray
) -> tuple[FloatArray, RunResult]:
    """Return where the steps from ``starts`` (n, 4, 4) end (m, 4, 4), and how the last did.

    Ends that met are one, those without overlap left out.
    """
    beforehand, ends, n = prior_information(prior), np.empty_like(starts), 0
    for start in range(len(starts)):
        state, settled = Current(starts[start].copy(), 0.0), False
        for iteration in range(criteria.max_iterations):
            gate = tightened(iteration, criteria.max_correspondence_distance)
            final = gate.distance <= LAST_GATE and gate.robust <= LAST_ROBUST
            sample = scans.every if settled else (scans.fine if final else scans.coarse)
            solution = solve_step(scans, prior, beforehand, state, sample, gate, last=settled)
            share = 0.5 if iteration >= DAMPED_FROM and not settled else 1.0
            step = share * solution.step
            state = Current(displaced(state.T, step), state.scale + share * solution.scale_step)
            overlap = solution.pairs >= MIN_PAIRS
            if settled or not overlap:
                break
            shift, turn = length(step[:3]), length(step[3:])
            small = shift < criteria.translation_epsilon and turn < criteria.rotation_epsilon
            settled = final and small
        if overlap and new_basin(state.T, ends[:n], reach(scans.moments)):
            ends[n] = state.T
            n += 1
    known = knowledge(scans, prior, beforehand, state, solution)
    last = RunResult(state, solution, known, len(sample.rows), iteration + 1, settled, overlap)
    return ends[:n].copy(), last


def prior_information(prior: Prior) -> FloatArray:
    """Return L0, the information of the prior on the estimated entries (k, k)."""
    k = len(prior.rows)
    information = np.zeros((k, k))
    if prior.covariance[0, 0] > 0.0:
        information[:] = np.linalg.inv(block(prior.covariance, prior.rows))
    return information


def new_basin(T: FloatArray, others: FloatArray, reach: float) -> bool:
    """Return whether ``T`` (4, 4) lies in none of the basins of ``others`` (n, 4, 4)."""
    for k in range(len(others)):  # noqa: SIM110
        if apart(T, others[k], reach) <= SAME_BASIN:
            return False
    return True


def reach(moments: Moments) -> float:
    """Return the RMS distance of points [m]: makes rotations comparable with translations."""
    second = moments.second
    return math.sqrt(second[0, 0] + second[1, 1] + second[2, 2])


def apart(a: FloatArray, b: FloatArray, reach: float) -> float:
    """Return by how much two poses (4, 4) displace points at a distance ``reach`` [m]."""
    square = 0.0
    for i in range(3):
        square += (a[i, 3] - b[i, 3]) ** 2
        for j in range(3):
            square += (reach * (a[i, j] - b[i, j])) ** 2 / 2.0
    return math.sqrt(square)


def length(v: FloatArray) -> float:
    """Return the length of a vector (3,)."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def tightened(iteration: int, widest: float) -> Gate:
    """Return the gate of a step."""
    tight, narrowest = TIGHTEN**iteration, min(LAST_GATE, widest)
    wide = tight * widest > narrowest
    return Gate(
        max(narrowest, tight * widest),
        max(LAST_ROBUST, FIRST_ROBUST * tight),
        FIRST_COSINE if wide else LAST_COSINE,
    )


def solve_step(
    scans: Scans,
    prior: Prior,
    beforehand: FloatArray,
    state: Current,
    sample: Sample,
    gate: Gate,
    *,
    last: bool,
) -> Solution:
    """Return the step at ``state``; the ``last`` with the errors that readings share."""
    shared = last and max(scans.both.patch, scans.both.linearity, scans.both.offset) > 0
    solution = solve(scans, prior, beforehand, state, sample, gate, shared=shared)
    if not shared:
        return solution
    spreads = solution.patch_spread, solution.spread
    j, k = max(spreads[0], spreads[0] ** 2), excess(spreads[1])
    both = scans.both
    found = both._replace(
        patch=j * both.patch, linearity=k * both.linearity, offset=k * both.offset,
        height=k * both.height, lean=k * both.lean,
    )  # fmt: skip
    scans = scans._replace(both=found)
    solution = solve(scans, prior, beforehand, state, sample, gate, shared=shared)
    return solution._replace(patch_spread=spreads[0], spread=spreads[1])


def excess(ratio: float) -> float:
    """Return the factor by which errors exceed the assumed ones, given their ``ratio`` to usual."""
    return ratio * ratio if ratio > MOST_SPREAD else 1.0


def solve(
    scans: Scans,
    prior: Prior,
    beforehand: FloatArray,
    state: Current,
    sample: Sample,
    gate: Gate,
    *,
    shared: bool,
) -> Solution:
    """Return the Gauss-Newton step at ``state``; the equation is at the module's head.

    ``beforehand`` is its L0, see ``prior_information``.
    """
    rows, k = prior.rows, len(prior.rows)
    at = (scans.target, sample, state.T, state.scale, gate, scans.both, rows)
    if shared:
        found = shared_errors(*at)
        data = State(*found.reduced())
        tested, spurious, pairs = data.H[:k, :k], found.spurious, found.pairs
    else:
        equations = normal_equations(*at)
        data = State(equations.information - equations.lost, equations.gradient)
        tested = equations.information[:k, :k]
        spurious, pairs = equations.spurious, equations.pairs

    # degenerate directions and nuisances
    kept, honest, dropped, least = determined(tested, spurious, reach(scans.moments))
    if least < MOST_STRETCH * SIGNAL:
        both = scans.both
        if shared:
            both = both._replace(share=1.0 / both.correlation, tilt=0.0)
        spurious = spurious + stretched(*at[:-2], both, rows)
        kept, honest, dropped, _ = determined(tested, spurious, reach(scans.moments))
    data = without_directions(data, dropped)
    data = with_prior(data, k, prior.yaw_scale, state.scale)
    H, g, by, constant = eliminated(data, k)

    # the equation
    H_edges, g_edges = edge_sums(
        scans.target_edges, scans.source_edges, state.T, gate.distance, EDGE_ROBUST * gate.robust
    )
    H_edges = block(H_edges, rows)
    off = picked(deviation(state.T, prior.mean), rows)
    right = kept @ g + picked(g_edges, rows) + beforehand @ off
    left = projected(kept, H) + H_edges + beforehand
    small = -(inverse(left, beforehand) @ right)

    # the step
    step = np.zeros(6)
    step[list(rows)] = small
    rest = by @ small + constant
    information = projected(honest, H) + H_edges + beforehand
    patch_spread = spread = math.nan
    if shared:
        patch_spread = found.spread(np.concatenate([small, rest]))
        known = State(state_prior(scans.both, rows), np.zeros(len(data.g)))
        known = with_prior(known, k, prior.yaw_scale, state.scale)
        values = rest + np.eye(len(rest))[0] * state.scale
        spread = state_spread(data.H[k:, k:], known.H[k:, k:], values) / USUAL_SPREAD
    spreads = patch_spread, spread
    return Solution(step, rest[0], information, dropped, H_edges, pairs, *spreads)


def knowledge(
    scans: Scans, prior: Prior, beforehand: FloatArray, state: Current, solution: Solution
) -> Knowledge:
    """Return what is known of ``state`` by the ``solution`` whose step led to it."""
    small = inverse(solution.information, beforehand)
    covariance, information = np.zeros((6, 6)), np.zeros((6, 6))
    for i in range(len(prior.rows)):
        for j in range(len(prior.rows)):
            covariance[prior.rows[i], prior.rows[j]] = small[i, j]
            information[prior.rows[i], prior.rows[j]] = solution.information[i, j]
    degenerate, n = np.zeros((len(solution.dropped), 6)), 0
    for m in range(len(degenerate)):
        v = solution.dropped[m]
        if quadratic(solution.edges, v) <= quadratic(beforehand, v):
            for i in range(len(v)):
                degenerate[n, prior.rows[i]] = v[i]
            n += 1
    R = state.T[:3, :3].copy()
    turned = Moments(R @ scans.moments.first, projected(R, scans.moments.second))
    shift = about_target(state.T)
    back = 2.0 * np.eye(6) - shift
    return Knowledge(
        projected(shift, covariance),
        projected(back.T.copy(), information),
        degenerate[:n] @ shift.T.copy(),
        displacement(turned, covariance),
    )
