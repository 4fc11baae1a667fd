"""Registration of two sweeps by Gauss-Newton: the maximum a posteriori pose and its covariance.

Each step solves the normal equations of ``point_to_plane``, with the gate and the robust kernel
tightened from step to step, the odometry as a prior about the viewpoint, and vertical edges:

    (H_kept + H_edges + L0) step = -(g_kept + g_edges + L0 (x - x0)).

Degeneracy: H_kept holds those eigenvectors v of the scans' information matrix H whose information
is at least twice what noise of the normals adds, v^T H v >= 2 v^T H_spurious v, that is, as much
signal as noise (Hatleskog and Alexis, arXiv 2410.10784). A direction in doubt is tested once more
with the shape of the windows (``point_to_plane``). The other directions, such as a slide along a
wall, are left to prior and edges. The covariance is the inverse of the left side, less the spurious
information and what is lost to yaw jitter; for point-to-plane residuals that is sound (Bonnabel et
al., arXiv 1410.7632).

The yaw scale is a nuisance parameter, eliminated by its Schur complement; along degenerate
directions the scans say nothing of it, either. Once the iteration has converged, a last step uses
more surfels and, if ``bias_sigma`` > 0, has the errors that readings share as further unknowns: see
``shared_errors``. ``native/descend.h`` computes all of this.
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
from scan3d_twin.core.registration.point_to_plane import combine_noise
from scan3d_twin.core.registration.pose_prior import PLANAR, Moments, PosePrior
from scan3d_twin.core.registration.surfels.grid import SurfelGrid
from scan3d_twin.core.registration.undetermined import with_infinite_variance
from scan3d_twin.core.types import FloatArray, RegistrationResult, read_only

Dof = Literal["planar", "se3"]
MIN_PAIRS = 12
"""Least number of correspondences for a reliable step."""
SAMPLE_SIZE, LAST_SAMPLE_SIZE = 3000, 12000
"""Approximate number of the source's surfels in a step, and in the last one: there fewer would lose
accuracy on curved surfaces, where windows are small and overlap little."""
SAME_BASIN = 0.010
"""Poses whose displacement of the source differs by less than this are one basin [m]."""


class Criteria(NamedTuple):
    """Convergence criteria of the iteration, and its first, widest gate [m, rad]."""

    max_iterations: int = 30
    translation_epsilon: float = 1e-4
    rotation_epsilon: float = 1e-4
    max_correspondence_distance: float = 0.10


@dataclass(frozen=True)
class RunResult:
    """Result of the iteration.

    Attributes:
        T: ``T_target_source`` (4, 4).
        yaw_scale: Relative error of the yaws of both sweeps.
        covariance: Covariance of x y z rx ry rz about the target's origin (6, 6).
        information: Its inverse on the estimated entries (6, 6).
        degenerate: Directions (j, 6) that neither surfels nor edges determine.
        predicted_rmse: Expected RMS displacement of the source's surfels [m].
        pairs: Number of correspondences in the last step.
        square: Sum of their squared residuals [m2].
        spread: That of the errors that all readings share, in usual ones; NaN if not estimated.
        surfels: Number of the source's surfels in the last step.
        iterations: Number of steps.
        settled: Whether the iteration converged.
        overlap: Whether there were enough correspondences.
    """

    T: FloatArray
    yaw_scale: float
    covariance: FloatArray
    information: FloatArray
    degenerate: FloatArray
    predicted_rmse: float
    pairs: int
    square: float
    spread: float
    surfels: int
    iterations: int
    settled: bool
    overlap: bool

    @staticmethod
    def of(value: native.RunResult) -> RunResult:
        """Return the result that the engine wrote."""
        return RunResult(
            value.numbers("T", 4, 4),
            value.nuisances[0],
            value.numbers("covariance", 6, 6),
            value.numbers("information", 6, 6),
            value.numbers("degenerate", value.n_degenerate, 6),
            value.predicted_rmse,
            value.pairs,
            value.square,
            value.spread,
            value.surfels,
            value.iterations,
            bool(value.settled),
            bool(value.overlap),
        )


@dataclass(frozen=True)
class Problem:
    """Two sweeps to register, the prior, and the options.

    The steps use a sample of the source's surfels unless it is ``whole``.
    """

    target: SurfelGrid
    source: SurfelGrid
    prior: PosePrior | None = None
    dof: Dof = "planar"
    criteria: Criteria = field(default_factory=Criteria)
    whole: bool = False

    def __post_init__(self) -> None:
        if self.dof not in ("planar", "se3"):
            raise ConfigError(f"dof must be planar or se3, got {self.dof!r}")

    @property
    def dims(self) -> tuple[int, ...]:
        """The estimated entries of x y z rx ry rz."""
        return PLANAR if self.dof == "planar" else (0, 1, 2, 3, 4, 5)

    @cached_property
    def native_prior(self) -> native.Prior:
        """The prior of pose and yaw scale; infinite information where the scale is exact."""
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
        """Stride of the source's surfels in the steps at the final gate: 2 to 4, 1 if whole."""
        return (
            1 if self.whole else min(4, max(2, round(math.sqrt(self.source.count / SAMPLE_SIZE))))
        )

    @property
    def last_stride(self) -> int:
        """Stride of the source's surfels in the last step; 1 if whole."""
        return 1 if self.whole else max(1, round(math.sqrt(self.source.count / LAST_SAMPLE_SIZE)))

    @cached_property
    def moments(self) -> Moments:
        """Moments of the source's surfels that the first steps use."""
        return Moments.of(self.source.sample(2 * self.stride).points)

    @property
    def reach(self) -> float:
        """RMS distance of the source's points [m]: makes rotations comparable with translations."""
        return math.sqrt(np.trace(self.moments.second))

    def make_source(self, thinning: int = 1) -> native.Source:
        """Return the source as the engine takes it, with all strides times ``thinning``."""
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
    """Return the pose at which Gauss-Newton steps from ``init`` (4, 4) end, and its covariance.

    Raises:
        RegistrationError: The scans do not overlap at ``init``, or no longer after some steps.
    """
    _, outcome = follow_starts(problem, problem.make_source(), problem.criteria, init[None])
    if not outcome.overlap:
        raise RegistrationError(
            f"no overlap: only {outcome.pairs} pairs of surfels in reach, "
            f"{MIN_PAIRS} are needed; give a better init_T_target_source"
        )
    return outcome


def follow_starts(
    problem: Problem, source: native.Source, criteria: Criteria, starts: FloatArray
) -> tuple[FloatArray, RunResult]:
    """Return the poses where the steps from ``starts`` (n, 4, 4) end, and the last start's result.

    The poses (m, 4, 4) are distinct: of those in one basin the first is kept, and those without
    overlap are left out.
    """
    starts = np.ascontiguousarray(starts)
    ends, last = np.empty_like(starts), native.RunResult()
    n = engine.follow_starts(
        problem.target.target, source, combine_noise(problem.target, problem.source),
        problem.native_prior, native.Criteria(**criteria._asdict()),
        starts, len(starts), ends, last,
    )  # fmt: skip
    if n < 0:
        raise MemoryError
    return ends[:n], RunResult.of(last)


def distance_between(a: FloatArray, b: FloatArray, reach: float) -> float:
    """Return the displacement [m] between two poses (4, 4) of points at a distance ``reach``."""
    shift, turn = a[:3, 3] - b[:3, 3], reach * (a[:3, :3] - b[:3, :3])
    return math.sqrt(np.sum(shift * shift) + np.sum(turn * turn) / 2.0)


def make_result(problem: Problem, outcome: RunResult, ambiguity_gap: float) -> RegistrationResult:
    """Return ``outcome`` as the result of a registration.

    Without a prior, the directions that the scans do not determine have infinite variance.
    """
    free = outcome.degenerate if problem.prior is None else outcome.degenerate[:0]
    return RegistrationResult(
        T_target_source=read_only(outcome.T),
        covariance=read_only(with_infinite_variance(outcome.covariance, free, problem.reach)),
        information=read_only(outcome.information),
        fitness=outcome.pairs / outcome.surfels,
        inlier_rmse=math.sqrt(outcome.square / outcome.pairs),
        predicted_rmse=math.inf if len(free) else outcome.predicted_rmse,
        num_inliers=outcome.pairs,
        iterations=outcome.iterations,
        converged=outcome.settled and len(free) < len(problem.dims),
        degenerate_directions=read_only(outcome.degenerate),
        ambiguity_gap=ambiguity_gap,
        shared_spread=outcome.spread,
    )
