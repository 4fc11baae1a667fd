"""Closed-form error prediction: the covariance of the next registration, without running it.

For a candidate O2, each surfel of the latest view that O2 would see again contributes the
information of one point-to-plane pair, times the density of the readings from O2:

    H = sum density J J^T / (s_1^2 + s_2^2),    C = (H_kept + H_edges + L0)^-1,
    E^2 = mean over the points of tr(G C G^T),  G = (I, -[a]x).

The common bias and the yaw scale, the test for spurious information, edges, and the motion prior L0
about O2 enter as in the real registration. So does the range error that depends on the range and
is the same in both sweeps, the curve f of ``registration.shared_errors``. The derivatives by its
knots are c = b_there p(r_there) - b_here p(r_here), with b the cosines between normals and rays and
p the weights of linear interpolation. With Q = sum w J c^T, K = sum w c c^T and the prior's
covariance P it displaces the pose by D = (H + H_edges + L0)^-1 Q, and

    D (P^-1 + K - Q^T D)^-1 D^T

is added to C. E times the calibration is compared with epsilon. There is no sampling and no ICP,
so that wrong basins are not predicted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.mapping.motion_model import MotionModel
from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.planning.context import PlanningContext, mask_readings
from scan3d_twin.core.planning.surface.visibility import (
    NextSweep,
    Visible,
    find_visible,
    measure_ranges,
)
from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.registration.algebra import find_determined, marginalise
from scan3d_twin.core.registration.point_to_plane import (
    Equations,
    compute_jacobian,
    spurious_information,
)
from scan3d_twin.core.registration.pose_prior import (
    PLANAR,
    PLANAR_BLOCK,
    Moments,
    predict_rmse_of_moments,
)
from scan3d_twin.core.registration.surfels.edges import MIN_EDGE_COSINE, linearise_edges
from scan3d_twin.core.registration.surfels.extraction import NORMAL_VARIANCE, VARIANCE, X
from scan3d_twin.core.registration.surfels.grid import Sample
from scan3d_twin.core.registration.surfels.scan_noise import CURVE_RANGES
from scan3d_twin.core.types import (
    BoolArray,
    FloatArray,
    Pose2,
)

WANTED_SURFELS = 4000
"""Wanted number of surfels; each represents the readings that were left out around it."""
MIN_SHARED_SURFELS = 10
"""Number of shared surfels of the target below which there is no overlap."""
MIN_SHARED_SHARE = 0.2
"""The same as a share of the target's surfels, where these are few: the smallest overlap. A thin
thing may have none: then its surroundings alone are registered."""


@dataclass(frozen=True)
class ErrorPrediction:
    """Predictor of the errors of registrations on the latest view.

    Attributes:
        grid: Surfels of the latest view, in the scope of registration.
        on_target: Its readings of the target (n_lines, n_beams).
        config: The run's configuration.
        motion: Errors of the odometry, as learned in this run; as configured by default.
    """

    grid: SurfelGrid
    on_target: BoolArray
    config: Config
    motion: MotionModel | None = None

    @staticmethod
    def of(context: PlanningContext) -> ErrorPrediction:
        """Return the predictor for the latest view of a session.

        Raises:
            RegistrationError: The view shows too little surface.
        """
        view, config = context.view, context.session.config
        motion = MotionModel.of(context.session.views, config, context.session.workspace)
        on_target = mask_readings(view.target, view.image)
        grid = surfels_of(view, config, context.session.workspace)
        return ErrorPrediction(grid, on_target, config, motion)

    def error(self, viewpoint: Pose2, half: float | None = None) -> float:
        """Return the predicted error [m] of the next view's target, times the calibration.

        The next view is assumed to show as much of the target as this one, at the same distance.

        Args:
            viewpoint: O2 in frame ``scan`` of the latest view.
            half: Half the angle of the sweep there [rad]; all of it by default.

        Returns:
            Infinity without overlap.
        """
        # Select the surfels seen again
        config = self.config
        rows, t = self._rows, self.grid.image.T_base_lidar
        sweep = self._sweep if half is None else NextSweep.like(self.grid, half)
        seen = find_visible(rows, self._ranges, viewpoint, sweep, config.target.max_range)
        again_seen = np.count_nonzero(self._sampled_target[seen.index])
        if again_seen < self._needed or not np.any(self.on_target):
            return math.inf

        # Weigh them by noise and density
        again = self._sample.columns.take(seen.index, axis=1)
        a = again[:3] - np.array([[viewpoint.x], [viewpoint.y], [0.0]])
        J = compute_jacobian(a, again[3:6])
        ratio = _compare_cosines(again[3:6], a, again[:3], t[2, 3])
        variance = again[VARIANCE] * (1.0 + ratio)
        w = self._area * seen.density / (variance * self.grid.inflation)

        # Predict covariance and displacement
        equations = self._equations(seen, again, a, J, w)
        curve = _linearise_curve(again, a, J, w, t[2, 3])
        covariance = self._covariance(equations, viewpoint, sweep, curve)
        return config.planning.calibration * predict_rmse_of_moments(
            self._target.turned(viewpoint.yaw), covariance
        )

    @cached_property
    def _target(self) -> Moments:
        """Moments of the target's points in the frame of the latest view."""
        if np.any(self._sampled_target):
            return Moments.of(self._rows[self._sampled_target, X])
        return Moments.of(self.grid.image.points[self.on_target])

    @cached_property
    def _needed(self) -> float:
        """Number of shared surfels of the target that make an overlap."""
        return min(MIN_SHARED_SURFELS, MIN_SHARED_SHARE * np.count_nonzero(self._sampled_target))

    @cached_property
    def _sample(self) -> Sample:
        return self.grid.sample(max(2, round(math.sqrt(self.grid.count / WANTED_SURFELS))))

    @property
    def _stride(self) -> int:
        return self._sample.stride

    @cached_property
    def _area(self) -> float:
        return float(self._stride**2)

    @property
    def _rows(self) -> FloatArray:
        return self._sample.rows

    @cached_property
    def _ranges(self) -> FloatArray:
        return measure_ranges(self._rows, self.grid)

    @cached_property
    def _reach(self) -> float:
        """RMS range of the sample [m]."""
        return float(np.sqrt(np.mean(self._ranges**2)))

    @cached_property
    def _motion_model(self) -> MotionModel:
        """The motion model of the run, or the configured one."""
        return self.motion or MotionModel.of((), self.config)

    @cached_property
    def _sampled_target(self) -> BoolArray:
        """Which of the surfels belong to the target."""
        first = self._stride // 2
        grid = np.s_[first :: self._stride, first :: self._stride]
        return np.asarray(self.on_target[grid][self.grid.index[grid] >= 0])

    @cached_property
    def _sweep(self) -> NextSweep:
        sweep = self.config.sweep
        return NextSweep.like(self.grid, sweep.width / 2 + sweep.margin)

    def _equations(
        self, seen: Visible, again: FloatArray, a: FloatArray, J: FloatArray, w: FloatArray
    ) -> Equations:
        """Return the normal equations of perfect pairs, whose gradient is 0.

        Noise of the normals of one scan adds the spurious information F = sum w nu (B B^T - J J^T)
        to H, the mean normals of a pair have half of it. A direction of a pair must have 2 F / 2 in
        H - F / 2, and F / 2 of it is spurious. Here it must have 2 F in H, of which F is spurious:
        the same is left, and the next scan may show a quarter less of it.

        Args:
            seen: The surfels that O2 sees again.
            again: Their columns (8, k).
            a: Their lever arms (3, k) [m].
            J: Their Jacobian (6, k).
            w: Their weights (k,).
        """
        # Sum up information, yaw scale included
        n, here = again[3:6], self._sample.yaws[seen.index]
        swing = J[5]
        g = seen.yaws * swing - here * (n[1] * again[0] - n[0] * again[1])
        J = np.concatenate([J, g[None]])
        information = (J * w) @ J.T

        # Find what is spurious and what jitter takes
        nu = again[NORMAL_VARIANCE] + self.grid.noise.tilt_variance
        spurious = spurious_information(w * nu, a, J[:6])
        lost = self._lost(seen.yaws, w, swing, J)
        return Equations(information, lost, np.zeros(7), spurious, len(w), 0.0)

    def _lost(
        self, yaws: FloatArray, w: FloatArray, swing: FloatArray, J: FloatArray
    ) -> FloatArray:
        """Return the information (7, 7) that is lost by the yaw jitter of both scans' lines."""
        sigma = math.sqrt(2.0) * self.grid.noise.yaw_sigma
        if sigma == 0.0:
            return np.zeros((7, 7))
        line = np.round(yaws / (self._stride * self.grid.line_spacing)).astype(np.int64)
        line -= line.min()
        c = sigma * swing
        columns = np.concatenate([J, c[None]]) * (w * c)
        sums = np.stack([np.bincount(line, column) for column in columns])
        return np.asarray((sums[:7] / (self._stride + sums[7])) @ sums[:7].T)

    def _covariance(
        self, equations: Equations, viewpoint: Pose2, sweep: NextSweep, curve: _Curve
    ) -> FloatArray:
        """Return the covariance (6, 6) about O2 of a planar registration.

        Args:
            equations: The normal equations.
            viewpoint: O2.
            sweep: The sweep there.
            curve: What the curve of the range error does.
        """
        # Marginalise the yaw scale
        noise = self.grid.noise
        prior = 1.0 / noise.yaw_scale_sigma**2 if noise.yaw_scale_sigma > 0 else math.inf
        H = marginalise(equations.information - equations.lost, prior)

        # Keep honestly determined directions
        raw = equations.information[:6, :6][PLANAR_BLOCK]
        honest = find_determined(raw, equations.spurious[PLANAR_BLOCK], self._reach)[1]

        # Add edges and the prior
        motion = self._motion_model.spread(viewpoint).information(PLANAR)
        rest = self._edges(viewpoint, sweep)[PLANAR_BLOCK] + motion
        C = np.linalg.inv(honest @ H[PLANAR_BLOCK] @ honest.T + rest)

        # Add what the curve of the range error displaces
        g = honest @ curve.gradient[list(PLANAR)]
        off = np.linalg.solve(honest @ raw @ honest.T + rest, g)
        known = curve.information - g.T @ off
        left = np.linalg.inv(np.linalg.inv(noise.curve_covariance) + (known + known.T) / 2)
        C += off @ left @ off.T
        covariance = np.zeros((6, 6))
        covariance[PLANAR_BLOCK] = C
        return covariance

    def _edges(self, viewpoint: Pose2, sweep: NextSweep) -> FloatArray:
        """Return the information (6, 6) about O2 of the edges that a ``sweep`` there sees again."""
        edges, back = self.grid.edges, viewpoint.inverse()
        if len(edges) == 0:
            return np.zeros((6, 6))
        middle = np.column_stack([edges.places, edges.heights.mean(axis=1)])
        seen = sweep.cells(back.apply(middle))[0] >= 0
        again = edges.select(seen & self._still_edges(viewpoint))
        moved = again.seen_from(back)
        return linearise_edges(again, moved, viewpoint.matrix(), 1.0, 1e3)[0]

    def _still_edges(self, viewpoint: Pose2) -> BoolArray:
        """Return which edges are edges from O2, too.

        Registration finds none where a surface is seen too flat, or where another face goes on
        behind it: one is assumed to be at a right angle to the surface that ends there.
        """
        normals, outwards = self._edge_directions
        towards = np.array([viewpoint.x, viewpoint.y]) - self.grid.edges.places
        cosines = np.sum(normals * towards, axis=1) / np.linalg.norm(towards, axis=1)
        turned_away = np.sum(outwards * towards, axis=1) <= 0.0
        return np.asarray(turned_away & (cosines > MIN_EDGE_COSINE))

    @cached_property
    def _edge_directions(self) -> tuple[FloatArray, FloatArray]:
        """Normals (n, 2) at the edges, and directions along the surface out across them (n, 2).

        They are those of the nearest surfels.
        """
        edges, rows = self.grid.edges, self._rows
        apart = rows[:, None, :2] - edges.places
        normals = rows[np.argmin(np.sum(apart * apart, axis=2), axis=0), 3:5]
        sideways = np.stack([normals[:, 1], -normals[:, 0]], axis=1)
        signs = -edges.sides * np.sign(np.sum(sideways * edges.across, axis=1))
        return normals, sideways * signs[:, None]


class _Curve(NamedTuple):
    """What a range error that depends on the range, the same in both sweeps, does to their pairs.

    Attributes:
        gradient: The information that it shares with the pose (6, k) [1/m2, 1/m].
        information: Its own (k, k) [1/m2].
    """

    gradient: FloatArray
    information: FloatArray


def _linearise_curve(
    again: FloatArray, a: FloatArray, J: FloatArray, w: FloatArray, height: float
) -> _Curve:
    """Return the equations of the range error at ``CURVE_RANGES``.

    It displaces every surface along the rays. As far as these or their lengths differ between the
    two sweeps, as round a curved thing, it looks like a motion.

    Args:
        again: Columns (8, k) of the surfels that O2 sees again.
        a: Their lever arms (3, k) [m].
        J: Their Jacobian (6, k).
        w: Their weights (k,).
        height: Height of the lidar [m].
    """
    up = np.array([[0.0], [0.0], [height]])
    c = _differentiate_by_curve(again[3:6], a - up) - _differentiate_by_curve(
        again[3:6], again[:3] - up
    )
    weighted = w * c
    return _Curve(J @ weighted.T, weighted @ c.T)


def _differentiate_by_curve(normals: FloatArray, rays: FloatArray) -> FloatArray:
    """Return by how much range errors at ``CURVE_RANGES`` move points along ``normals`` (24, k).

    Args:
        normals: Unit normals (3, k).
        rays: From the lidar to the points (3, k) [m].
    """
    ranges, step = np.linalg.norm(rays, axis=0), CURVE_RANGES[1]
    apart = np.abs(np.minimum(ranges, CURVE_RANGES[-1]) - CURVE_RANGES[:, None])
    cosines = np.sum(normals * rays, axis=0) / ranges
    return np.asarray(cosines * np.maximum(0.0, 1.0 - apart / step))


def predict_by_odometry(context: PlanningContext, viewpoint: Pose2) -> float:
    """Return the error [m] of the next view's target by odometry alone, times the calibration.

    It is what is left where the latest view shows too little surface for a prediction. The next
    view is assumed to show as much of the target as this one, at the same distance.

    Args:
        context: After the latest view, which shows the target.
        viewpoint: O2 in frame ``scan`` of the latest view.
    """
    session = context.session
    motion = MotionModel.of(session.views, session.config, session.workspace)
    target = Moments.of(context.view.target.points).turned(viewpoint.yaw)
    expected = predict_rmse_of_moments(target, motion.spread(viewpoint).covariance)
    return session.config.planning.calibration * expected


def _compare_cosines(n: FloatArray, a: FloatArray, here: FloatArray, height: float) -> FloatArray:
    """Return the squared ratio (k,) of the incidence cosines from O2 and from the latest view.

    Args:
        n: Normals (3, k).
        a: Points relative to O2 (3, k) [m].
        here: Points relative to the latest view (3, k) [m].
        height: Height of the lidar [m].
    """

    def square(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        facing = n[0] * x + n[1] * y + n[2] * z
        return np.asarray(facing * facing / (x * x + y * y + z * z))

    there = square(a[0], a[1], a[2] - height)
    return there / np.maximum(square(here[0], here[1], here[2] - height), 1e-4)
