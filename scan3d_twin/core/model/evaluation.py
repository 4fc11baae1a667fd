"""Evaluation of a model against the truth: coverage, accuracy and registration errors.

Definitions follow Tanks and Temples (precision, recall, F-score), DTU (accuracy, completeness) and
the Surface Edge Explorer (coverage). The model is aligned to the truth by its first pose only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scan3d_twin.core.errors import ConfigError, ScanError
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.core.model.fused_cloud import Model, build_model, thin_by_voxel
from scan3d_twin.core.model.judged_targets import find_judged_targets
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.model.pose_errors import PairError, find_true_pose, measure_pair_error
from scan3d_twin.core.model.sampled_surface import Surface
from scan3d_twin.core.model.truth import Truth
from scan3d_twin.core.registration.kd_tree import Tree
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2

MIN_F_SCORE = 0.3
"""F-score at 20 mm below which a model is no success, whatever its registration errors: a thing
with the wall it stood at had 0.07 to 0.19, a third of ``plain_wall`` in 14 good views 0.33."""
COVERAGE_DISTANCE = 0.020
"""Distance of a model point within which a surface point is covered [m]; twice the range
accuracy."""
F_SCORE_DISTANCES = (0.010, 0.020, 0.030)
"""Distances of the F-scores [m]."""
TRUTH_SPACING = 0.005
"""Spacing of the samples of the true surface [m]: a quarter of ``COVERAGE_DISTANCE``."""
MAX_TRUTH_SAMPLES = 200_000
"""Largest number of these samples: on a large target the spacing is larger."""
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
            measure_pair_error(k, session, reference.poses, reference.T_map_world)
            for k in range(1, len(session.views))
        ),
        targets=reference.targets,
        left_out=reference.left_out,
    )


def measure_mesh_accuracy(mesh: Mesh, reference: Reference, rng: np.random.Generator) -> Distances:
    """Return the distances of ``MESH_SAMPLES`` points spread over ``mesh`` to the true surface.

    Raises:
        ScanError: The mesh has no triangles.
    """
    points = mesh.sample(MESH_SAMPLES, rng)
    if len(points) == 0:
        raise ScanError("the mesh has no triangles: there is nothing to evaluate")
    return Distances.of(reference.surface.distance(reference.T_map_world.apply(points)))


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
