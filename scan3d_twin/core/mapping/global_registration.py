"""Global registration: the pose of a view without odometry in the model so far.

A scanner that is set down by hand has no odometry: the pose is known only to lie somewhere about
the earlier views. It is found by multistart without a prior. From each earlier view, starts spread
over ``START_XY`` and ``START_YAW`` follow a few Gauss-Newton steps; the most plausible ends are
aligned to convergence, without a prior, so that what the surfaces leave open has infinite variance.
With o the share of the surfels of either view that lie on the other, averaged over both, and c
their contradiction with free space (``free_space``), a pose is judged by its

    misfit = 1 - o + c,    0..2.

The contradiction alone would prefer poses at which the views hardly see each other; the overlap
alone would accept a wall behind another one. Over several earlier views, o is the largest of their
overlaps, and c the mean of the contradictions, weighted by overlap. The difference in misfit to the
next best basin is the result's ``ambiguity_gap``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.registration import PosePrior, SurfelGrid
from scan3d_twin.core.registration.gauss_newton import (
    SAME_BASIN,
    Problem,
    RunResult,
    align,
    distance_between,
    follow_starts,
    make_result,
)
from scan3d_twin.core.registration.multistart import (
    ROUGH_ITERATIONS,
    ROUGH_THINNING,
    spread_starts,
)
from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.surfels.free_space import measure_contradiction
from scan3d_twin.core.registration.undetermined import MIN_COMPONENT
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult, read_only, wrap

START_XY, START_YAW = 0.5, math.radians(30.0)
"""Standard deviations of the starts about an earlier view [m], [rad]: people set a scanner down
within about 1 m and 60 deg of where it stood (an assumption), which is two of them."""
SEARCHED = 3.0
"""Distance from an earlier view up to which places are looked for, in those standard deviations. A
wall farther off, seen from behind, fits onto the wall ahead: what was not searched is not found."""
STARTS = 256
"""Number of starts for each earlier view: one in (0.2 m)^2 and 8 deg of three standard
deviations, about what the steps find their way from."""
MAX_BASINS = 6
"""Basins that are aligned to convergence for each earlier view, the least misfit first."""
APART = 0.10
"""Displacement above which rough poses lead to different basins [m]."""
OVERLAP_GATE, OVERLAP_STRIDE = 0.05, 8
"""Largest distance of a surfel from the surface that it lies on [m], three times the noise of the
readings and more; and the stride of the surfels that are asked."""
MIN_OVERLAP = 0.25
"""Least overlap of a right pose: in 40 views of living_room right ones had 0.31 to 0.96."""
MAX_CONTRADICTION = 0.20
"""Largest contradiction of a right pose: in simulated rooms right ones have 0.01 to 0.05, wrong
ones 0.2 to 0.6."""
MIN_GAP = 0.10
"""Least difference in misfit between the best basin and the next for a unique pose."""


@dataclass(frozen=True)
class Located:
    """A view that was found in the model so far.

    Attributes:
        T_world_scan: Its pose.
        reference: Index of the earlier view that it overlaps most.
        overlap: Share of the surfels of either that lie on the other, 0..1.
        result: Its registration on that view; ``ambiguity_gap`` is the difference in misfit to the
            next best place.
    """

    T_world_scan: Pose2
    reference: int
    overlap: float
    result: RegistrationResult

    @property
    def is_unique(self) -> bool:
        """Whether no other place fits nearly as well, and the surfaces leave no direction open."""
        determined = len(self.result.degenerate_directions) == 0
        return determined and self.result.ambiguity_gap >= MIN_GAP


@dataclass(frozen=True)
class _Place:
    """A pose of the source in the world, by its registration on one earlier view.

    Attributes:
        reference: Index of the earlier view.
        outcome: The alignment on it.
        T: ``T_world_scan``.
        overlap: Largest overlap with an earlier view, 0..1.
        contradiction: Mean contradiction with the earlier views, 0..1.
    """

    reference: int
    outcome: RunResult
    T: Pose2
    overlap: float
    contradiction: float

    @property
    def misfit(self) -> float:
        """How little the source fits there, 0..2."""
        return 1.0 - self.overlap + self.contradiction


def register_globally(
    targets: Sequence[SurfelGrid | None], poses: Sequence[Pose2], source: SurfelGrid
) -> Located:
    """Return where ``source`` lies in the model of earlier views, without any prior.

    Pure: the same arguments give the same bits.

    Args:
        targets: Surfels of the earlier views; None for one without a surface.
        poses: ``T_world_scan`` of each.
        source: Surfels of the new view.

    Raises:
        RegistrationError: It fits nowhere.
    """
    # Align from all earlier views, and judge by all of them
    places = [
        _judge(targets, poses, source, k, outcome)
        for k, target in enumerate(targets)
        if target is not None
        for outcome in _find_basins(target, source)
    ]
    places = [place for place in places if _was_searched(poses, place.T)]
    places.sort(key=lambda place: place.misfit)
    if not places:
        raise RegistrationError(
            "it fits nowhere: no earlier view shows the same surfaces; place the scanner nearer to "
            "an earlier place"
        )

    # Refuse what cannot be right
    best = places[0]
    if best.overlap < MIN_OVERLAP or best.contradiction > MAX_CONTRADICTION:
        raise RegistrationError(
            f"it fits nowhere: at the best place {best.overlap:.0%} overlap an earlier view and "
            f"{best.contradiction:.0%} contradict it; place the scanner nearer to an earlier place"
        )

    # Compare with the next best place
    reach = _measure_reach(source)
    apart = (
        place.misfit - best.misfit
        for place in places[1:]
        if distance_between(place.T.matrix(), best.T.matrix(), reach) > 3 * SAME_BASIN
    )
    gap = min([1.0, *apart])
    target = targets[best.reference]
    assert target is not None
    result = make_result(Problem(target, source), best.outcome, gap)
    return Located(best.T, best.reference, best.overlap, result)


def transfer_result(result: RegistrationResult, T_target_reference: Pose2) -> RegistrationResult:
    """Return a registration on a view ``reference`` as one on another view, ``target``.

    With T_target_reference = (R, t), a motion (d, r) about the reference's origin is one about the
    target's, r' = R r and d' = R d + t x r'. The pose of the two earlier views counts as exact.
    """
    T = T_target_reference.matrix()
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[:3, 3:] = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    back = np.linalg.inv(adjoint)

    # Directions of infinite variance stay infinite
    known = np.isfinite(result.covariance)
    moved = adjoint @ np.where(known, result.covariance, 0.0) @ adjoint.T
    reached = np.abs(adjoint) > MIN_COMPONENT
    moved[reached.astype(int) @ ~known @ reached.T.astype(int) > 0] = math.inf
    return replace(
        result,
        T_target_source=read_only(T @ result.T_target_source),
        covariance=read_only(moved),
        information=read_only(back.T @ result.information @ back),
        degenerate_directions=read_only(result.degenerate_directions @ adjoint.T),
    )


def _find_basins(target: SurfelGrid, source: SurfelGrid) -> Iterator[RunResult]:
    """Yield the alignments on one earlier view from its most plausible rough poses."""
    # Follow the starts roughly, merging what meets
    spread = PosePrior.planar(Pose2(), START_XY, START_YAW)
    problem = Problem(target, source, spread)
    poses, rough = spread_starts(problem, np.eye(4), STARTS), problem.make_source(ROUGH_THINNING)
    for iterations in ROUGH_ITERATIONS:
        criteria = problem.criteria._replace(max_iterations=iterations)
        poses = follow_starts(problem, rough, criteria, poses)[0]

    # Keep the most plausible ones that lie apart
    ranked = sorted(poses, key=lambda pose: _measure_misfit(target, source, pose))
    kept: list[FloatArray] = []
    for pose in ranked:
        if all(distance_between(pose, other, problem.reach) > APART for other in kept):
            kept.append(pose)

    # Align without a prior
    free = Problem(target, source)
    for pose in kept[:MAX_BASINS]:
        with suppress(RegistrationError):
            outcome = align(free, pose)
            if outcome.settled:
                yield outcome


def _judge(
    targets: Sequence[SurfelGrid | None],
    poses: Sequence[Pose2],
    source: SurfelGrid,
    reference: int,
    outcome: RunResult,
) -> _Place:
    """Return the place of an alignment on view ``reference``, judged by all earlier views."""
    T = poses[reference] @ Pose2.from_matrix(outcome.T)
    overlaps, contradictions = [0.0], [0.0]
    for target, pose in zip(targets, poses, strict=True):
        if target is not None:
            T_target_source = (pose.inverse() @ T).matrix()
            overlaps.append(_measure_overlap(target, source, T_target_source))
            contradictions.append(_measure_contradiction(target, source, T_target_source))
    contradiction = float(np.dot(overlaps, contradictions)) / max(sum(overlaps), 1e-9)
    return _Place(reference, outcome, T, max(overlaps), contradiction)


def _was_searched(poses: Sequence[Pose2], T: Pose2) -> bool:
    """Return whether the starts about one of the earlier views' ``poses`` reach ``T``."""
    return any(
        pose.distance(T) <= SEARCHED * START_XY
        and abs(wrap(T.yaw - pose.yaw)) <= SEARCHED * START_YAW
        for pose in poses
    )


def _measure_misfit(target: SurfelGrid, source: SurfelGrid, T: FloatArray) -> float:
    return 1.0 - _measure_overlap(target, source, T) + _measure_contradiction(target, source, T)


def _measure_overlap(target: SurfelGrid, source: SurfelGrid, T: FloatArray) -> float:
    """Return the share of the surfels of either view that lie on the other, the mean of both."""
    gate = Gate(OVERLAP_GATE, 1.0)
    back = np.asarray(np.linalg.inv(T), dtype=np.float64)
    shares = [
        linearise(a, b, OVERLAP_STRIDE, pose, 0.0, gate).pairs / len(b.sample(OVERLAP_STRIDE))
        for a, b, pose in ((target, source, T), (source, target, back))
    ]
    return sum(shares) / 2


def _measure_contradiction(target: SurfelGrid, source: SurfelGrid, T: FloatArray) -> float:
    return measure_contradiction(target, source, T, OVERLAP_STRIDE)


def _measure_reach(source: SurfelGrid) -> float:
    return Problem(source, source).reach
