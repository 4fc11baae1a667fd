"""The motion model of this robot, learned from its own registrations: how its odometry errs.

A robot errs by constants of its own. Let b = (c, delta, k) be the relative error of its distances
(wheel radii), the drift of its heading per metre (their difference) and the relative error of its
turns (wheel base). A move of legs, each a turn t_i and then a drive of length l_i, that has turned
by theta_i = t_1 + ... + t_i and driven s_i before its drive i, ends at

    yaw = (1 + k) sum t_i + delta sum l_i,
    xy  = sum (1 + c) l_i sinc(delta l_i / 2) u_i,   bearing of u_i = (1 + k) theta_i
                                                                 + delta (s_i + l_i / 2),

as each drive is an arc. A is the derivative of that by b, at the b in question: after 2.6 m with a
drift of 0.08 rad/m, a robot stands 0.27 m beside where odometry has it, and 22 mm from where A at
b = 0 puts it. What is left changes from move to move: a share of the configured errors
(``planning.motion_variation``), and the play of the wheels.

Each registration without its prior (``remove_prior``) measures that end, and so d = A b, in the
directions that its scans determine, with information L_d. With N the covariance of what changes, b
is estimated by Bayesian regression, recursively, linear about the b that it finds (an iterated
Kalman filter; Bell and Cathey, IEEE TAC 38, 1993):

    W = L_d (I + N L_d)^-1,   M <- M + w A^T W A,   m <- m + w A^T W d,
    Lambda = Lambda_0 + M / D,   eta = eta_0 + m / D,

from the configured errors as the prior (Lambda_0, eta_0), and from the turns of the first panorama
if they were corrected by it. A registration in the wrong basin has little weight w (Geman and
McClure's kernel, ``CHI2_GATE``).

The registrations of a run do not err independently: a range that is measured too long, by the same
millimetres each time, looks like an error of the odometry of which there is more in each step round
a curved thing. With a correlation rho between them (``ERROR_CORRELATION``), and u = tr(Lambda_0^-1
w A^T W A) the information of each, the variance of their weighted mean is larger by the design
effect (Kish, Survey Sampling, 1965)

    D = 1 + rho (k - 1),   k = (sum sqrt u)^2 / sum u.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import cast

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.mapping.motion_prior import motion_prior, sum_variances
from scan3d_twin.core.mapping.pose_graph import CHI2_GATE
from scan3d_twin.core.mapping.prior_removal import remove_prior
from scan3d_twin.core.navigation.legs import Legs, assume_legs, check_legs, follow_legs
from scan3d_twin.core.planning_config import PlanningConfig
from scan3d_twin.core.registration import PosePrior
from scan3d_twin.core.registration.pose_prior import PLANAR, shift_to_target
from scan3d_twin.core.session import YAW_SCALE_REPEATABILITY, TurnScale, View, Workspace
from scan3d_twin.core.types import (
    FloatArray,
    Observation,
    Pose2,
    RegistrationResult,
    read_only,
    wrap,
)

PLAY_XY, PLAY_YAW = 0.0006, math.radians(0.05)
"""Standard deviations of a move of no length where the constants of the robot are learned [m],
[rad]: what is left of the errors with its constants fitted, by benchmarks/motion_error.py."""
PRIOR_INNOVATIONS = 6.0
"""Weight of the configured motion error in degrees of freedom: those of two moves."""
MIN_VARIANCE_REDUCTION = 0.5
"""Share of the odometry's variance that registration must remove in a direction to measure the
odometry's error there."""
MAX_SIGMA_SHARE = 0.5
"""Standard deviation of a learned scale of turns, as a share of what was known before, from which
sweeps are corrected by it (assumption): a look around leaves too little for any to reach it."""
NO_ERRORS = read_only(np.zeros(3))
"""The b of a robot that is exactly its data sheet."""
LINEARISATIONS = 3
"""Times that what a move teaches is made linear about what it has taught: the second changes a move
of 2.6 m by millimetres, the third by micrometres."""
TURNS = 2
"""Index of the relative error of turns in b."""
ERROR_CORRELATION = 0.5
"""Correlation of the errors of a run's registrations: with it the squared error of the corrected
odometry, in units of the model's variance, is the same all along a run (0.47 after one step, 0.42
after five and more); with none it grows to 0.53 (24 tours of round bodies on an open floor, with a
``motion_variation`` of 0.02)."""


@dataclass(frozen=True)
class Evidence:
    """Sums over the registrations of a run, with the names of the module's docstring.

    Attributes:
        M: Information on b (3, 3).
        m: The same times what was measured (3,).
        u: Sum of the information u of each, in units of the prior's.
        roots: Sum of their square roots.
    """

    M: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    m: FloatArray = field(default_factory=lambda: np.zeros(3))
    u: float = 0.0
    roots: float = 0.0

    def add(self, M: FloatArray, m: FloatArray, u: float) -> Evidence:
        """Return the sums with one registration more."""
        return Evidence(self.M + M, self.m + m, self.u + u, self.roots + math.sqrt(max(u, 0.0)))

    @property
    def design_effect(self) -> float:
        """Factor D by which correlation enlarges the variance; 1 without evidence."""
        if self.u <= 0.0:
            return 1.0
        return 1.0 + ERROR_CORRELATION * (self.roots**2 / self.u - 1.0)


@dataclass(frozen=True)
class MotionModel:
    """What is known of the errors of a robot's odometry.

    Attributes:
        config: The configured errors.
        before: Mean (3,) and covariance (3, 3) of b before the first move: per metre, rad per
            metre, per radian. A covariance of 0 where nothing is learned.
        evidence: What the registrations have shown of it.
        scale: Factor by which the errors of this robot exceed what the model expects.
        heading: Heading in which the latest sweep has left the robot, from its middle [rad].
        sweeps: By how much the turns of sweeps are corrected as they are taken, and what is left.
        chi2: Sum of the squared normalised innovations so far.
        freedom: Their number: degrees of freedom of ``chi2``.
    """

    config: PlanningConfig
    before: tuple[FloatArray, FloatArray]
    sweeps: TurnScale
    evidence: Evidence = field(default_factory=Evidence)
    scale: float = 1.0
    heading: float = 0.0
    chi2: float = 0.0
    freedom: int = 0

    @staticmethod
    def of(
        views: Sequence[View], config: Config, workspace: Workspace | None = None
    ) -> MotionModel:
        """Return the model after ``views``; pure, so that a resumed run learns the same.

        The ``workspace`` keeps what each view has taught, so that it is worked out once in a run.

        The factor is estimated from innovations: a registration moves the pose by d from the
        prior's mean. With P the prior's covariance and C the result's, d has the covariance P - C;
        where C is small compared with P, d^T (P - C)^-1 d estimates the squared factor. The model
        counts like ``PRIOR_INNOVATIONS`` such squares of 1. Only the motion prior is scaled, not
        the error that registration adds.
        """
        known = _Lessons(MotionModel._configured(config))
        if views and workspace is not None:
            key = _Lessons, config.planning, config.mount, config.registration
            known = workspace.results_of(views[0].observation.image).setdefault(key, known)
        for previous, view in pairwise(views):
            known = _take_lesson(known, previous, view, workspace)
        heading = find_last_heading(views[-1].observation) if views else 0.0
        return replace(
            known.model,
            heading=heading,
            chi2=known.square - PRIOR_INNOVATIONS,
            freedom=round(known.count - PRIOR_INNOVATIONS),
        )

    @staticmethod
    def _configured(config: Config) -> MotionModel:
        """Return the model before the first move."""
        planning, turns = config.planning, config.planning.gamma
        learned = 1.0 - planning.motion_variation**2
        mean = np.zeros(3)
        if config.mount.yaw_scale and learned > 0:
            mean[2] = config.mount.yaw_scale
            turns = min(turns, config.registration.yaw_scale_sigma)
        sigmas = np.array([planning.lambda_, planning.drift, turns])
        sweeps = TurnScale(config.mount.yaw_scale, config.registration.yaw_scale_sigma)
        return MotionModel(planning, (mean, learned * np.diag(sigmas**2)), sweeps)

    @cached_property
    def _estimate(self) -> tuple[FloatArray, FloatArray]:
        """Mean (3,) and covariance (3, 3) of b: those of eta and Lambda."""
        mean, covariance = self.before
        if not self._is_learned or self.evidence.u <= 0.0:
            return mean, covariance
        information = np.linalg.inv(covariance)
        D = self.evidence.design_effect
        posterior = np.linalg.inv(information + self.evidence.M / D)
        estimate = posterior @ (information @ mean + self.evidence.m / D)
        return estimate, (posterior + posterior.T) / 2

    @property
    def mean(self) -> FloatArray:
        """Estimate of b (3,)."""
        return self._estimate[0]

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the estimate; 0 where nothing is learned."""
        return self._estimate[1]

    @property
    def turns(self) -> TurnScale | None:
        """How sweeps are to be corrected, as the base turns in them as it does between views.

        None where that is not known much better than it was when they were taken.
        """
        if not self._is_learned:
            return None
        sigma = math.hypot(math.sqrt(self.covariance[TURNS, TURNS]), YAW_SCALE_REPEATABILITY)
        if sigma > MAX_SIGMA_SHARE * self.sweeps.sigma:
            return None
        return TurnScale((1.0 + self.mean[TURNS]) / (1.0 + self.sweeps.scale) - 1.0, sigma)

    @property
    def _is_learned(self) -> bool:
        return self.config.motion_variation < 1.0

    @property
    def _spread(self) -> FloatArray:
        """Covariance of b (3, 3), more where this robot errs more than expected.

        It is never less: small innovations are part of the estimate already, and say nothing of the
        directions that no registration has determined.
        """
        return max(1.0, self.scale) ** 2 * self.covariance

    def prior(
        self, move: Pose2, legs: Legs | None = None, errors: FloatArray | None = None
    ) -> PosePrior:
        """Return the prior of a ``move`` by odometry ``T_previous_next``, corrected by the model.

        Args:
            move: The move.
            legs: How it was made; by default a turn, a drive and a turn.
            errors: The b (3,) about which it is linear; the model's mean by default.
        """
        if errors is None or not self._is_learned:
            return self._about(self.correct(move, legs), move, legs)
        off, A = self._displace(move, legs, errors)
        mean = _add(move, off + A @ (self.mean - errors))
        return self._with_covariance(mean, move, A)

    def spread(self, viewpoint: Pose2) -> PosePrior:
        """Return the distribution of where a move to ``viewpoint`` ends, about that viewpoint.

        Args:
            viewpoint: Where the move leads, in ``scan`` of the latest view.
        """
        return self._about(viewpoint, viewpoint, None)

    def correct(self, move: Pose2, legs: Legs | None = None) -> Pose2:
        """Return a ``move`` by odometry, corrected by the mean of the model."""
        return _add(move, self._displace(move, legs, self.mean)[0]) if self._is_learned else move

    def learn(self, move: Pose2, legs: Legs, result: RegistrationResult) -> MotionModel:
        """Return the model after a ``move`` that registration has measured as ``result``."""
        if not self._is_learned:
            return self
        learned = self
        for _ in range(LINEARISATIONS):
            learned = self._learn_about(learned.mean, move, legs, result)
        return learned

    def _learn_about(
        self, errors: FloatArray, move: Pose2, legs: Legs, result: RegistrationResult
    ) -> MotionModel:
        """Return the model after a measured ``move``, linear about ``errors`` (3,)."""
        # Measure the error by the scans alone
        measured, information = remove_prior(result, self.prior(move, legs, errors))
        shift = shift_to_target(result.T_target_source)[np.ix_(PLANAR, PLANAR)]
        information = shift.T @ information @ shift
        assumed, A = self._displace(move, legs, errors)
        d = np.array([measured.x - move.x, measured.y - move.y, wrap(measured.yaw - move.yaw)])
        d += A @ errors - assumed

        # Weigh it by what may differ this time
        N = self._changing(move)
        off, P = d - A @ self.mean, N + A @ self._spread @ A.T
        chi2 = float(off @ _add_noise(information, P) @ off)
        W = (CHI2_GATE / (CHI2_GATE + chi2)) ** 2 * _add_noise(information, N)

        # Add it to the evidence
        M = A.T @ W @ A
        u = float(np.trace(self.before[1] @ M))
        return replace(self, evidence=self.evidence.add(M, A.T @ W @ d, u))

    def _about(self, mean: Pose2, move: Pose2, legs: Legs | None) -> PosePrior:
        """Return the prior about ``mean`` with the covariance of a ``move``."""
        if not self._is_learned:
            return motion_prior(mean, self.config, self.scale)
        return self._with_covariance(mean, move, self.jacobian(move, legs))

    def _with_covariance(self, mean: Pose2, move: Pose2, A: FloatArray) -> PosePrior:
        """Return the prior about ``mean`` with the covariance of a ``move`` of jacobian ``A``."""
        C = self._changing(move) + A @ self._spread @ A.T
        return PosePrior.of_robot(mean, (C + C.T) / 2)

    def _changing(self, move: Pose2) -> FloatArray:
        """Return the covariance (3, 3) of what changes from move to move."""
        share, config = self.config.motion_variation, self.config
        part = replace(
            config,
            lambda_=share * config.lambda_,
            gamma=share * config.gamma,
            drift=share * config.drift,
        )
        return self.scale**2 * sum_variances(move, part, PLAY_XY, PLAY_YAW)

    def jacobian(self, move: Pose2, legs: Legs | None) -> FloatArray:
        """Return A (3, 3) of the module's docstring, along the axes of the move's start.

        Args:
            move: The move.
            legs: How it was made; by default a turn, a drive and a turn.
        """
        return self._displace(move, legs, self.mean)[1]

    def _displace(
        self, move: Pose2, legs: Legs | None, errors: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return by how much ``errors`` (3,) move a move's end (3,), and A (3, 3) there."""
        legs = assume_legs(move, self.heading) if legs is None else legs
        end, A = follow_legs(legs, errors)
        return end - follow_legs(legs, NO_ERRORS)[0], A


def _add(move: Pose2, off: FloatArray) -> Pose2:
    """Return ``move`` with ``off`` (3,) added to x, y and yaw."""
    x, y, yaw = off.tolist()
    return Pose2(move.x + x, move.y + y, move.yaw + yaw)


@dataclass(frozen=True)
class _Lessons:
    """What the views of a run have taught so far.

    Attributes:
        model: The model.
        square: Sum of the squared normalised innovations, those of the prior included.
        count: Their number.
    """

    model: MotionModel
    square: float = PRIOR_INNOVATIONS
    count: float = PRIOR_INNOVATIONS


def _take_lesson(
    known: _Lessons, previous: View, view: View, workspace: Workspace | None
) -> _Lessons:
    """Return what is known after ``view``, from the ``workspace`` if it was worked out before."""
    result, seen = view.registration, view.observation
    if result is None or not result.converged or not seen.has_odometry:
        return known
    move, legs = describe_move(previous, seen)
    results = {} if workspace is None else workspace.results_of(seen.image)
    before, registered, how, after = results.get(_Lessons, (None, None, None, None))
    if before is known and registered is result and how == (move, legs):
        return cast(_Lessons, after)

    # Learn from the innovation
    model = known.model.learn(move, legs, result)
    prior = replace(known.model, scale=1.0).prior(move, legs, model.mean)
    innovation = _normalise_innovation(prior, result)
    square = known.square + float(innovation @ innovation)
    count = known.count + len(innovation)
    model = replace(model, scale=math.sqrt(square / count))
    after = _Lessons(model, square, count)
    results[_Lessons] = known, result, (move, legs), after
    return after


def _add_noise(information: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the ``information`` (3, 3) of a measurement with more noise; it may be singular."""
    result = information @ np.linalg.inv(np.eye(3) + covariance @ information)
    return np.asarray(result + result.T) / 2


def describe_move(previous: View, observation: Observation) -> tuple[Pose2, Legs]:
    """Return the move from ``previous`` to ``observation`` by odometry, and its legs.

    Where they were not recorded, or began at another view, the move counts as the shortest one.
    """
    move = previous.observation.T_odom_scan.inverse() @ observation.T_odom_scan
    if check_legs(observation.legs, move):
        return move, observation.legs
    return move, assume_legs(move)


def find_last_heading(observation: Observation) -> float:
    """Return the heading of the base at a sweep's last line, from its middle [rad]."""
    image = observation.image
    if len(image.stamps) == 0 or image.T_scan_axis is not None:
        return 0.0
    return float(image.yaws[int(np.argmax(image.stamps)), image.spec.n_beams // 2])


def _normalise_innovation(prior: PosePrior, result: RegistrationResult) -> FloatArray:
    """Return the normalised innovations (k,) in the directions that registration determines."""
    rows = np.ix_(PLANAR, PLANAR)
    back = np.linalg.inv(shift_to_target(result.T_target_source))
    C = (back @ result.covariance @ back.T)[rows]
    whitener = np.linalg.inv(np.linalg.cholesky(prior.covariance[rows]))
    gained, directions = np.linalg.eigh(np.eye(3) - whitener @ C @ whitener.T)
    d = directions.T @ whitener @ prior.deviation(result.T_target_source)[list(PLANAR)]
    determined = gained > MIN_VARIANCE_REDUCTION
    return np.asarray(d[determined] / np.sqrt(gained[determined]))
