"""Simulated registration: SiICP on what would be visible, with the grid engine of real runs.

Each draw displaces the robot from the candidate O2 by the errors of a turn, a drive and a turn,
scans the surfaces of the latest view from both viewpoints anew (``virtual_scan``) and registers the
two scans exactly as real ones. Its error is the displacement of the target's points. All candidates
share the same draws, and sampling stops early when the outcome is certain (``sequential_test``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import repeat

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.planning.context import PlanningContext, mask_readings
from scan3d_twin.core.planning.prediction.error_prediction import MIN_SHARED_SHARE
from scan3d_twin.core.planning.prediction.sequential_test import is_decided
from scan3d_twin.core.planning.prediction.virtual_scan import DrawnNoise, Planes, Surface
from scan3d_twin.core.planning.surface.visibility import NextSweep
from scan3d_twin.core.registration import PosePrior, SurfelGrid, register
from scan3d_twin.core.registration.pose_prior import PLANAR
from scan3d_twin.core.registration.surfels.extraction import X
from scan3d_twin.core.types import BoolArray, FloatArray, Pose2, read_only, rms

MIN_SHARED_READINGS = 10
"""Number of shared readings of the target below which there is no overlap."""
TARGET_STRIDE = 7
"""Stride of the target's points over which an error is measured."""
HERE_STREAM, THERE_STREAM, MOTION_STREAM = 0, 1, 2
"""Random streams of a draw: the noise of the scan from here, of the scan from O2, the motion."""


@dataclass(frozen=True)
class SimulatedRegistration:
    """Simulator of registrations on the latest view.

    Attributes:
        grid: Surfels of the latest view, in the scope of registration.
        on_target: Its readings of the target (n_lines, n_beams).
        config: The run's configuration.
        seed: Seed of the draws, the same for all candidates.
        motion: Errors of the odometry, as learned in this run; as configured by default.
    """

    grid: SurfelGrid
    on_target: BoolArray
    config: Config
    seed: int
    motion: MotionModel | None = None

    @staticmethod
    def of(context: PlanningContext, seed: int) -> SimulatedRegistration:
        """Return the simulator for the latest view of a session.

        Raises:
            RegistrationError: The view shows too little surface.
        """
        view, config = context.view, context.session.config
        on_target = mask_readings(view.target, view.image)
        motion = MotionModel.of(context.session.views, config, context.session.workspace)
        grid = surfels_of(view, config, context.session.workspace)
        return SimulatedRegistration(grid, on_target, config, seed, motion)

    def error(self, viewpoint: Pose2, draws: int, half: float | None = None) -> float:
        """Return the ``planning.quantile`` of the errors [m] of up to ``draws`` draws, rounded up.

        Args:
            viewpoint: O2 in the frame of the latest view.
            draws: Largest number of draws; fewer when ``planning.certainty`` is reached.
            half: Half the angle of the next sweep [rad]; all of it by default.
        """
        planning = self.config.planning
        errors: list[float] = []
        for error in self.errors(viewpoint, draws, half):
            errors.append(error)
            failed = sum(e > planning.epsilon for e in errors)
            if is_decided(failed, len(errors), draws, planning.quantile, planning.certainty):
                break
        return float(np.quantile(errors, planning.quantile, method="higher"))

    def errors(self, viewpoint: Pose2, draws: int, half: float | None = None) -> Iterator[float]:
        """Yield the error [m] of each draw; infinite if too little of the target is in view."""
        planes = self._surface.seen_from(viewpoint, self._next_sweep(half))
        index = self.grid.index[self.on_target]
        own = index[index >= 0]
        least = min(MIN_SHARED_READINGS, MIN_SHARED_SHARE * len(own))
        if np.count_nonzero(planes.on_target) < least or not np.any(self.on_target):
            yield from repeat(math.inf, draws)
            return
        prior = (self.motion or MotionModel.of((), self.config)).spread(viewpoint)
        points = self.grid.rows[own[::TARGET_STRIDE], X]
        if len(own) == 0:  # thinner than a surfel
            points = self.grid.image.points[self.on_target]
        for k in range(draws):
            yield self._error(k, planes, points, prior)

    def _error(self, k: int, planes: Planes, points: FloatArray, prior: PosePrior) -> float:
        """Return the error [m] of draw ``k``, over ``points`` (n, 3) in the frame of O2.

        The points are those of the latest view, as the next view shows about as much at a similar
        distance. Scans that cannot be registered keep the pose by odometry. Whether free space
        contradicts the pose is not asked: what the latest view did not see hides nothing here.
        """
        # Draw the motion
        truth = prior.T
        guess = displace_prior(prior, self._rng(k, MOTION_STREAM).standard_normal(3))

        # Scan and register as in a run
        try:
            here, noise = self._here(k)
            result = register(
                here,
                planes.read(noise, self._rng(k, THERE_STREAM)),
                prior=guess,
                starts=self.config.registration.starts,
            )
        except RegistrationError:
            return _displacement(points, guess.T, truth)
        return _displacement(points, result.T_target_source, truth)

    def _here(self, k: int) -> tuple[SurfelGrid, DrawnNoise]:
        """Return the scan from here of draw ``k``, and the noise of both of its scans.

        Raises:
            RegistrationError: Too little surface is in view.
        """
        if k in self._scans:
            return self._scans[k]
        rng, assumed = self._rng(k, HERE_STREAM), self.grid.noise
        noise = DrawnNoise.draw(assumed, rng)
        scan = self._surface.here.read(noise, rng), noise
        if self.config.optimize_for == "speed":
            self._scans[k] = scan
        return scan

    @cached_property
    def _scans(self) -> dict[int, tuple[SurfelGrid, DrawnNoise]]:
        return {}

    def _rng(self, k: int, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, k, stream])

    @cached_property
    def _surface(self) -> Surface:
        return Surface(self.grid, self.on_target, self.config.target.max_range)

    def _next_sweep(self, half: float | None) -> NextSweep:
        """Return the next sweep of ``half`` [rad] to either side; None for all of it."""
        if half is None:
            half = self.config.sweep.width / 2 + self.config.sweep.margin
        if half not in self._sweeps:
            self._sweeps[half] = NextSweep.like(self.grid, half)
        return self._sweeps[half]

    @cached_property
    def _sweeps(self) -> dict[float, NextSweep]:
        return {}


def displace_prior(prior: PosePrior, draw: FloatArray) -> PosePrior:
    """Return ``prior`` with its mean displaced by standard normal numbers ``draw`` (3,)."""
    half = np.linalg.cholesky(prior.covariance[np.ix_(PLANAR, PLANAR)])
    x, y, yaw = half @ draw
    pose = Pose2.from_matrix(prior.T)
    moved = Pose2(pose.x + x, pose.y + y, pose.yaw + yaw)
    return replace(prior, T=read_only(moved.matrix()))


def _displacement(points: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """Return the RMS distance [m] of ``points`` (n, 3) mapped by ``a`` and by ``b`` (4, 4)."""
    return rms(Pose2.from_matrix(a).apply(points) - Pose2.from_matrix(b).apply(points))
