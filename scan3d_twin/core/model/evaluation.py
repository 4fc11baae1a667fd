"""Evaluation of a model against the truth: coverage, accuracy and registration errors.

Definitions follow Tanks and Temples (precision, recall, F-score), DTU (accuracy, completeness) and
the Surface Edge Explorer (coverage). The model is aligned to the truth by its first pose only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError, ScanError
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.core.model.fused_cloud import Model, build_model, thin_by_voxel
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.model.sampled_surface import Surface
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2, rms, wrap

MIN_F_SCORE = 0.3
"""F-score at 20 mm below which a model is no success, whatever its registration errors: a thing
with the wall it stood at had 0.07 to 0.19, a third of ``plain_wall`` in 14 good views 0.33."""
TARGET_SPACING = 0.02
"""Spacing of the samples that tell which targets are one thing to the robot [m]."""
MIN_HINT_SHARE = 0.1
"""Least share of the panorama's points of the target that a target holds which was scanned."""
COVERAGE_DISTANCE = 0.020
"""Distance of a model point within which a surface point is covered [m]; twice the range
accuracy."""
F_SCORE_DISTANCES = (0.010, 0.020, 0.030)
"""Distances of the F-scores [m]."""
TRUTH_SPACING = 0.005
"""Spacing of the samples of the true surface [m]: a quarter of ``COVERAGE_DISTANCE``."""
TRUTH_LINES = 64
"""About the number of lines whose mean pose is the true one of a sweep: their errors of 0.6 mrad
leave 0.1."""
MAX_TRUTH_SAMPLES = 200_000
"""Largest number of these samples: on a large target the spacing is larger."""
HINT_DISTANCE = 0.3
"""Distance from the target within which the panorama's points of it are [m]: lines 2 deg apart and
odometry."""
MESH_SAMPLES = 50_000
"""Number of points that represent a mesh: on 2 m2 one every 6 mm, as dense as the truth's."""


@dataclass(frozen=True, slots=True)
class Distances:
    """Statistics of a set of distances [m]."""

    mean: float
    median: float
    p95: float

    @staticmethod
    def of(distances: FloatArray) -> Distances:
        """Return the statistics of ``distances`` (n,); NaN of none."""
        if len(distances) == 0:
            return Distances(np.nan, np.nan, np.nan)
        return Distances(
            float(np.mean(distances)),
            float(np.median(distances)),
            float(np.quantile(distances, 0.95)),
        )


@dataclass(frozen=True, slots=True)
class PairError:
    """Registration error of a view.

    Attributes:
        view: Index of the view.
        error: RMS displacement of its target points by ``T_prev_new`` from the true one [m].
        pose_error: RMS displacement of its target points in the world, after final alignment [m].
        odometry_error: ``error`` of the odometry, before registration [m]; NaN without odometry.
    """

    view: int
    error: float
    pose_error: float
    odometry_error: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The measures of a run against the truth.

    Attributes:
        coverage: Share of the coverable surface within ``COVERAGE_DISTANCE`` of the model.
        coverage_by_view: The same after the first view, the first two, and so on.
        accuracy: Distance from the model to the true surface.
        completeness: Distance from the coverable surface to the model.
        f_score: F-score by distance [m].
        coverable_share: Share of the target's surface that is visible from a feasible pose; where
            none is, coverage is 0.
        pairs: Registration errors, one per registered view.
        targets: Names of the targets that the model is judged by.
        left_out: Names of others that nobody chose to leave out.
    """

    coverage: float
    coverage_by_view: tuple[float, ...]
    accuracy: Distances
    completeness: Distances
    f_score: dict[float, float]
    coverable_share: float
    pairs: tuple[PairError, ...]
    targets: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def is_success(self, epsilon: float) -> bool:
        """Return whether every registration error is at most ``epsilon`` [m].

        It also takes two views, and a model that shows the target rather than other things.
        """
        within = all(pair.error <= epsilon for pair in self.pairs)
        return bool(self.pairs) and within and self.f_score[0.020] >= MIN_F_SCORE


@dataclass(frozen=True)
class Reference:
    """The truth of one session, computed once for all measures.

    Attributes:
        truth: Its source.
        poses: True ``T_map_scan`` of each view.
        T_map_world: Alignment of the model to the truth, by its first pose only.
        surface: The surface in ``map`` of the targets that count.
        coverable: Which of its samples a robot can cover (n,), see ``find_coverable_surface``.
        targets: Their names.
        left_out: Names of other targets, unless one was asked for.
    """

    truth: Truth
    poses: tuple[Pose2, ...]
    T_map_world: Pose2
    surface: Surface
    coverable: BoolArray
    targets: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    @staticmethod
    def of(session: Session, truth: Truth, asked: str = "") -> Reference:
        """Return the reference for ``session``, which has views; errors as for ``evaluate``.

        The target that was ``asked`` for by name counts, or else those that the panorama's points
        of the target are on. Targets closer to one another than ``target.cluster_gap`` are one
        thing to the robot, and count together. If there is none, all count.
        """
        end = float(session.views[-1].observation.image.stamps.max())
        if truth.latest < end:
            raise ConfigError(
                f"this truth ends at {truth.latest:.1f} s and the session at {end:.1f} s: evaluate "
                "a session with the truth of the very run that scanned it"
            )
        poses = tuple(find_true_pose(view, truth) for view in session.views)
        T_map_world = poses[0] @ session.views[0].T_world_scan.inverse()

        # Choose the targets that count
        targets = find_judged_targets(session, truth, asked)
        left_out = () if asked else tuple(t for t in truth.targets if t not in targets)
        surface = _sample_truth(truth, targets)
        coverable = find_coverable_surface(surface.points, surface.normals, truth, session.config)
        return Reference(truth, poses, T_map_world, surface, coverable, targets, left_out)


def evaluate(session: Session, truth: Truth) -> Evaluation:
    """Return the measures of ``session`` against the ``truth`` of the same run.

    Of several targets, those count that were scanned, and what is close to them.

    Raises:
        ConfigError: The truth is of another run, which ended earlier.
        ScanError: No view shows anything of the target.

    >>> evaluation = s3d.evaluate(session, truth)
    >>> 0.0 < evaluation.coverage <= 1.0, evaluation.accuracy.median < 0.01
    (True, True)
    """
    return evaluate_model(session, build_model(session), Reference.of(session, truth))


@dataclass(frozen=True, eq=False)
class Comparison:
    """A model beside the truth, point by point, in ``world``.

    Attributes:
        distances: Distance of each point of the model to the true surface (n,) [m].
        to_model: Distance of each coverable sample of that surface to the model (k,) [m].
        surface: All its samples (m, 3) [m].
        missing: The coverable samples that are not covered (j, 3) [m].
    """

    distances: FloatArray
    to_model: FloatArray
    surface: FloatArray
    missing: FloatArray

    @staticmethod
    def of(model: Model, reference: Reference) -> Comparison:
        """Return ``model``, which has points, beside the truth."""
        T_world_map, surface = reference.T_map_world.inverse(), reference.surface
        points = reference.T_map_world.apply(model.points)
        wanted = surface.points[reference.coverable]
        to_model, _ = Tree.of(points).closest(wanted)
        return Comparison(
            surface.distance(points),
            to_model,
            T_world_map.apply(surface.points),
            T_world_map.apply(wanted[to_model > COVERAGE_DISTANCE]),
        )


def evaluate_model(
    session: Session, model: Model, reference: Reference, compared: Comparison | None = None
) -> Evaluation:
    """Return the measures of ``session`` and its ``model``, not fused, against ``reference``.

    Args:
        session: The run.
        model: Its model.
        reference: The truth.
        compared: The model beside the truth, if that has been computed.

    Raises:
        ScanError: No view shows anything of the target.
    """
    if not any(len(view.target) for view in session.views):
        raise ScanError("no view shows anything of the target: there is no model to evaluate")

    # Choose the surface that counts
    surface, points = reference.surface, reference.T_map_world.apply(model.points)
    wanted = surface.points[reference.coverable]
    compared = Comparison.of(model, reference) if compared is None else compared

    # Measure model, surface and poses
    covered = _measure_coverage_by_view(points, model.view, len(session.views), wanted)
    return Evaluation(
        coverage=covered[-1],
        coverage_by_view=covered,
        accuracy=Distances.of(compared.distances),
        completeness=Distances.of(compared.to_model),
        f_score={
            d: _compute_f_score(
                surface.distance(thin_by_voxel(points, d / 2)), compared.to_model, d
            )
            for d in F_SCORE_DISTANCES
        },
        coverable_share=_share(reference.coverable),
        pairs=tuple(
            _measure_pair_error(k, session, reference) for k in range(1, len(session.views))
        ),
        targets=reference.targets,
        left_out=reference.left_out,
    )


def find_judged_targets(session: Session, truth: Truth, asked: str = "") -> tuple[str, ...]:
    """Return the names of the targets by which ``session`` is judged, see ``Reference.of``."""
    names = truth.targets
    if len(names) < 2:
        return names

    # Find the targets that were asked for or seen
    trees = {name: Tree.of(truth.surface(TARGET_SPACING, [name])[0][:, :2]) for name in names}
    chosen = (
        [asked] if asked in names else _find_hinted(trees, lay_on_truth(session, truth), session)
    )
    if not chosen:
        return names

    # Add those that are one thing with them
    reach, gap = list(chosen), session.config.target.cluster_gap
    while reach:
        tree = trees[reach.pop()]
        for name in names:
            if name not in chosen and np.any(tree.is_near(trees[name].points, gap)):
                chosen.append(name)
                reach.append(name)
    return tuple(name for name in names if name in chosen)


def _find_hinted(trees: Mapping[str, Tree], T_map_world: Pose2, session: Session) -> list[str]:
    """Return the names of the targets that the panorama's points of the target are on."""
    hint = T_map_world.apply(session.hint)
    distances = np.stack([tree.closest(hint)[0] for tree in trees.values()])
    nearest = np.where(distances.min(axis=0) <= HINT_DISTANCE, distances.argmin(axis=0), -1)
    return [name for k, name in enumerate(trees) if np.mean(nearest == k) >= MIN_HINT_SHARE]


def is_of_target(session: Session, truth: Truth, asked: str = "") -> bool:
    """Return whether ``session`` is of the target of ``truth``, and not of another thing.

    Most of the panorama's points are on it; of a target that was ``asked`` for by name, which may
    be a part of what the robot takes for one thing, ``MIN_HINT_SHARE`` of them are.
    """
    named = asked in truth.targets
    surface, _ = truth.surface(HINT_DISTANCE, [asked] if named else None)
    hint = lay_on_truth(session, truth).apply(session.hint)
    distances = Tree.of(surface[:, :2]).closest(hint)[0]
    return bool(np.quantile(distances, MIN_HINT_SHARE if named else 0.5) <= HINT_DISTANCE)


def measure_mesh_accuracy(mesh: Mesh, reference: Reference, rng: np.random.Generator) -> Distances:
    """Return the distances of ``MESH_SAMPLES`` points spread over ``mesh`` to the true surface.

    Raises:
        ScanError: The mesh has no triangles.
    """
    points = mesh.sample(MESH_SAMPLES, rng)
    if len(points) == 0:
        raise ScanError("the mesh has no triangles: there is nothing to evaluate")
    return Distances.of(reference.surface.distance(reference.T_map_world.apply(points)))


def lay_on_truth(session: Session, truth: Truth) -> Pose2:
    """Return ``T_map_world``, the alignment of the model to the truth by its first pose only."""
    return find_true_pose(session.views[0], truth) @ session.views[0].T_world_scan.inverse()


def _measure_coverage_by_view(
    points: FloatArray, view: IntArray, n_views: int, surface: FloatArray
) -> tuple[float, ...]:
    """Return the share of ``surface`` (n, 3) covered by the first view, the first two and so on.

    Each view is searched only for samples that are not covered yet, and only within a small
    distance, as distant neighbours are slow to find.
    """
    covered, shares = np.zeros(len(surface), dtype=bool), []
    for k in range(n_views):
        left = np.flatnonzero(~covered)
        distance, _ = Tree.of(points[view == k]).closest(surface[left], 2 * COVERAGE_DISTANCE)
        covered[left] = distance <= COVERAGE_DISTANCE
        shares.append(_share(covered))
    return tuple(shares)


def find_true_pose(view: View, truth: Truth) -> Pose2:
    """Return the true ``T_map_scan`` of a view: where its lines as a whole were taken.

    Each line was read at a heading that is off by the line's own error, 0.6 mrad on a `typical`
    robot, and from a place that wanders by a millimetre while the base turns. The pose at a single
    line would count that line's error as one of the sweep's registration; the mean over
    ``TRUTH_LINES`` lines does not. Where a turntable turns the lidar the base stands: then any line
    tells where.
    """
    image = view.observation.image
    beam = image.spec.n_beams // 2
    headings, stamps = image.yaws[:, beam], image.stamps + image.spec.beam_times[beam]
    middle = int(np.argmin(np.abs(headings)))
    there = truth.pose_at(float(stamps[middle]))
    if image.T_scan_axis is not None:
        return there

    # Average over lines, relative to the one in the middle
    start = there @ Pose2(0.0, 0.0, -float(headings[middle]))
    every = max(1, len(stamps) // TRUTH_LINES)
    lines = zip(stamps[::every].tolist(), headings[::every].tolist(), strict=True)
    found = [(truth.pose_at(stamp), heading) for stamp, heading in lines]
    x, y, turned = np.mean(
        [(base.x, base.y, wrap(base.yaw - heading - start.yaw)) for base, heading in found], axis=0
    )
    return Pose2(float(x), float(y), start.yaw + float(turned))


def measure_displacement(points: FloatArray, a: Pose2, b: Pose2) -> float:
    """Return the RMS distance [m] of ``points`` (n, 3) mapped by ``a`` and by ``b``."""
    return rms(a.apply(points) - b.apply(points))


def measure_view_error(k: int, session: Session, truth: Truth) -> float:
    """Return the RMS displacement of view ``k``'s points by ``T_prev_new`` from the true one [m].

    This is ``PairError.error``, known as soon as the view is registered.
    """
    true = find_true_pose(session.views[k - 1], truth).inverse() @ find_true_pose(
        session.views[k], truth
    )
    return _measure_registration_error(k, session, true)


def _measure_registration_error(k: int, session: Session, T_prev_new: Pose2) -> float:
    previous, view = session.views[k - 1], session.views[k]
    registered = previous.T_world_scan.inverse() @ view.T_world_scan
    return measure_displacement(_judged_points(view), registered, T_prev_new)


def _judged_points(view: View) -> FloatArray:
    """Return the points of the target; all where the view shows nothing of it."""
    return view.target.points if len(view.target) else view.sweep.points


def _measure_pair_error(k: int, session: Session, reference: Reference) -> PairError:
    """Return the errors of view ``k``."""
    previous, view = session.views[k - 1], session.views[k]
    points = _judged_points(view)
    true = reference.poses[k - 1].inverse() @ reference.poses[k]
    odometry = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    return PairError(
        view=k,
        error=_measure_registration_error(k, session, true),
        pose_error=measure_displacement(
            points, reference.T_map_world @ view.T_world_scan, reference.poses[k]
        ),
        odometry_error=measure_displacement(points, odometry, true)
        if view.observation.has_odometry
        else math.nan,
    )


def _sample_truth(truth: Truth, targets: Sequence[str]) -> Surface:
    """Return the true surface of ``targets`` by at most ``MAX_TRUTH_SAMPLES`` samples."""
    points, normals = truth.surface(TRUTH_SPACING, targets)
    if len(points) <= MAX_TRUTH_SAMPLES:
        return Surface.of(points, normals, TRUTH_SPACING)
    spacing = TRUTH_SPACING * float(np.sqrt(len(points) / MAX_TRUTH_SAMPLES))
    return Surface.of(*truth.surface(spacing, targets), spacing)


def _compute_f_score(to_truth: FloatArray, to_model: FloatArray, distance: float) -> float:
    """Return 2PR/(P+R) at ``distance`` [m]; the model is thinned so that all parts weigh alike."""
    precision, recall = _share(to_truth <= distance), _share(to_model <= distance)
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def _share(chosen: BoolArray) -> float:
    """Return the share of what is ``chosen`` (n,); 0 of nothing."""
    return float(np.mean(chosen)) if len(chosen) else 0.0
