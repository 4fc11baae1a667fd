"""Registration of two sweeps on the grids they were taken on: maximum a posteriori, honestly.

Gauss-Newton on the normal equations of ``point_to_plane``, with the gate and the robust weights
tightened from step to step, the odometry as prior about the viewpoint and vertical edges:

    (H_kept + H_edges + L0) step = -(g_kept + g_edges + L0 (x - x0)).

H_kept holds those eigenvectors v of the scans' information H whose information exceeds twice what
noise of the normals adds, v^T H v >= 2 v^T H_spurious v (Hatleskog and Alexis, arXiv 2410.10784):
on a wall the rest would be a slide that looks like knowledge, so it is left to prior and edges.
Twice means: as much signal as noise. The covariance is the inverse of the left side, less what is
spurious and what yaw jitter hides; for point to plane that is sound (Bonnabel et al., arXiv
1410.7632).

The yaw scale is a nuisance, eliminated by its Schur complement. ``native/descend.h`` computes all
of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.registration import native
from scan3d_twin.core.registration.native import engine
from scan3d_twin.core.registration.point_to_plane import pair_noise
from scan3d_twin.core.registration.pose_prior import PLANAR, Moments, PosePrior
from scan3d_twin.core.registration.surfel_grid import SurfelGrid
from scan3d_twin.core.registration.surfels import X
from scan3d_twin.core.types import FloatArray, RegistrationResult, read_only

Dof = Literal["planar", "se3"]
MIN_PAIRS = 12
"""Fewer correspondences than this determine nothing reliably."""
WANTED, WANTED_LAST = 3000, 12000
"""Surfels used of a source, and in the very last step: fewer lose accuracy where the surface bends,
as windows are small and overlap little there."""
SAME_BASIN = 0.010
"""Poses that displace the source by less than this from each other are one basin [m]."""


class Criteria(NamedTuple):
    """When the iteration ends, and the widest gate."""

    max_iterations: int = 30
    translation_epsilon: float = 1e-4
    rotation_epsilon: float = 1e-4
    max_correspondence_distance: float = 0.10


@dataclass(frozen=True)
class RunResult:
    """Where the iteration ended.

    Attributes:
        T: ``T_target_source`` (4, 4).
        yaw_scale: Relative error of the yaws of both sweeps.
        covariance: Of x y z rx ry rz about the target's origin (6, 6).
        information: Its inverse on the estimated entries (6, 6).
        degenerate: Directions (j, 6) that neither surfels nor edges determine.
        predicted_rmse: RMS displacement of the source's surfels to be expected [m].
        pairs: That took part in the last step.
        square: Sum of their squared residuals [m2].
        surfels: Of the source that took part in it.
        iterations: Steps in all.
        settled: Whether they became small enough.
        overlap: Whether enough surfels found a partner.
    """

    T: FloatArray
    yaw_scale: float
    covariance: FloatArray
    information: FloatArray
    degenerate: FloatArray
    predicted_rmse: float
    pairs: int
    square: float
    surfels: int
    iterations: int
    settled: bool
    overlap: bool

    @staticmethod
    def of(value: native.RunResult) -> RunResult:
        """Return the outcome that the engine wrote."""
        return RunResult(
            value.numbers("T", 4, 4),
            value.nuisances[0],
            value.numbers("covariance", 6, 6),
            value.numbers("information", 6, 6),
            value.numbers("degenerate", value.n_degenerate, 6),
            value.predicted_rmse,
            value.pairs,
            value.square,
            value.surfels,
            value.iterations,
            bool(value.settled),
            bool(value.overlap),
        )


@dataclass(frozen=True)
class Problem:
    """Two grids and what is known beforehand."""

    target: SurfelGrid
    source: SurfelGrid
    prior: PosePrior | None = None
    dof: Dof = "planar"
    criteria: Criteria = field(default_factory=Criteria)

    def __post_init__(self) -> None:
        if self.dof not in ("planar", "se3"):
            raise ConfigError(f"dof must be planar or se3, got {self.dof!r}")

    @property
    def dims(self) -> tuple[int, ...]:
        """The estimated entries of x y z rx ry rz."""
        return PLANAR if self.dof == "planar" else (0, 1, 2, 3, 4, 5)

    @cached_property
    def beforehand(self) -> native.Prior:
        """The prior, and that of the yaw scale: its information is infinite where it is exact."""
        sigma = max(self.target.noise.yaw_scale_sigma, self.source.noise.yaw_scale_sigma)
        return native.Prior(
            mean=self.prior.T if self.prior else np.eye(4),
            covariance=self.prior.covariance if self.prior else np.zeros((6, 6)),
            n_entries=len(self.dims),
            entries=self.dims,
            n_nuisances=1,
            nuisance_information=[1.0 / sigma**2 if sigma > 0 else math.inf],
        )

    @cached_property
    def stride(self) -> int:
        """Of the source's surfels in the steps at the last gate: 2 to 4."""
        return min(4, max(2, round(math.sqrt(self.source.count / WANTED))))

    @property
    def last_stride(self) -> int:
        """Of the source's surfels in the very last step."""
        return max(1, round(math.sqrt(self.source.count / WANTED_LAST)))

    @cached_property
    def moments(self) -> Moments:
        """Moments of the source's surfels, of those of the first steps."""
        return Moments.of(np.ascontiguousarray(self.source.sample(2 * self.stride).rows[:, X]))

    @property
    def reach(self) -> float:
        """RMS distance of the source's points [m]: it makes turns comparable with shifts."""
        return math.sqrt(np.trace(self.moments.second))

    def laid(self, thinning: int = 1) -> native.Source:
        """Return what is laid on the target, of every ``thinning``-th line and beam taken."""
        fine = self.stride * thinning
        return native.Source(
            coarse=self.source.sample(2 * fine).value,
            fine=self.source.sample(fine).value,
            every=self.source.sample(self.last_stride).value,
            edges=self.source.edge_rows,
            n_edges=len(self.source.edge_rows),
            first=self.moments.first,
            second=self.moments.second,
        )


def align(problem: Problem, init: FloatArray) -> RunResult:
    """Return where Gauss-Newton steps from ``init`` (4, 4) end.

    Raises:
        RegistrationError: The scans do not overlap at ``init``, or lost each other on the way.
    """
    _, outcome = follow_starts(problem, problem.laid(), problem.criteria, init[None])
    if not outcome.overlap:
        raise RegistrationError(
            f"no overlap: only {outcome.pairs} pairs of surfels in reach, "
            f"{MIN_PAIRS} are needed; give a better init_T_target_source"
        )
    return outcome


def follow_starts(
    problem: Problem, source: native.Source, criteria: Criteria, starts: FloatArray
) -> tuple[FloatArray, RunResult]:
    """Return where the steps from ``starts`` (n, 4, 4) end (m, 4, 4), and how the last did.

    Ends that met are one, those without overlap left out.
    """
    starts = np.ascontiguousarray(starts)
    ends, last = np.empty_like(starts), native.RunResult()
    n = engine.follow(
        problem.target.target, source, pair_noise(problem.target, problem.source),
        problem.beforehand, native.Criteria(**criteria._asdict()), starts, len(starts), ends, last,
    )  # fmt: skip
    if n < 0:
        raise MemoryError
    return ends[:n], RunResult.of(last)


def distance_between(a: FloatArray, b: FloatArray, reach: float) -> float:
    """Return by how much two poses (4, 4) displace points at a distance ``reach`` [m]."""
    shift, turn = a[:3, 3] - b[:3, 3], reach * (a[:3, :3] - b[:3, :3])
    return math.sqrt(np.sum(shift * shift) + np.sum(turn * turn) / 2.0)


def report(outcome: RunResult, ambiguity_gap: float) -> RegistrationResult:
    """Return the result for the last state."""
    return RegistrationResult(
        T_target_source=read_only(outcome.T),
        covariance=read_only(outcome.covariance),
        information=read_only(outcome.information),
        fitness=outcome.pairs / outcome.surfels,
        inlier_rmse=math.sqrt(outcome.square / outcome.pairs),
        predicted_rmse=outcome.predicted_rmse,
        num_inliers=outcome.pairs,
        iterations=outcome.iterations,
        converged=outcome.settled,
        degenerate_directions=read_only(outcome.degenerate),
        ambiguity_gap=ambiguity_gap,
    )
