"""The model against the truth, where there is one: coverage, accuracy and registration errors.

Definitions follow Tanks and Temples (precision, recall, F-score), DTU (accuracy, completeness) and
the Surface Edge Explorer (coverage); the model is laid on the truth by its first pose alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, cKDTree

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.model.fused_cloud import Model, build_model, voxel_thin
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.neighbours import nearest
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import BoolArray, FloatArray, IntArray, Pose2, rms

COVERAGE_DISTANCE = 0.020
"""A surface point is covered when a model point is this near [m]: twice the range accuracy."""
F_DISTANCES = (0.010, 0.020, 0.030)
"""Distances of the F-scores [m]."""
SPACING = 0.005
"""Distance of the truth's samples [m]: a quarter of ``COVERAGE_DISTANCE`` ..."""
MOST_SAMPLES = 200_000
"""... or as much more as keeps them to this number on a large target."""
HINT_DISTANCE = 0.3
"""What a look around saw of the target lies this near to it [m]: lines 2 deg apart and odometry."""
MIN_COSINE = 0.15
"""Flatter than this (81 deg from the normal) a surface counts as not visible."""
POSE_STEP = 0.30
"""Grid of the poses from which surface can be covered [m]."""
EYE_HEIGHT = 0.30
"""Height of the lidar [m]; its 5 cm ahead of the axle are neglected here."""
LOOK_HEIGHTS = (0.05, 0.15, 0.25, 0.33)
"""Heights at which a pose must be free of things [m]."""
MESH_SAMPLES = 50_000
"""Points that stand for a mesh: over 2 m2 one every 6 mm, as dense as the truth's samples."""
HIT_TOLERANCE = 0.005
"""A ray that ends this near to a surface point has hit it [m]."""


class Truth(Protocol):
    """What the twin knows and no planner may: frame ``map`` is the simulator's world."""

    @property
    def spawn(self) -> Pose2:
        """Where the robot was opened, in ``map``."""
        ...

    @property
    def front(self) -> Pose2 | None:
        """A pose on the target's front in ``map``, x along the outward normal; None if none."""
        ...

    def pose_at(self, stamp: float) -> Pose2:
        """Return the base's true pose in ``map`` at ``stamp`` [s]."""
        ...

    def surface(self, spacing: float) -> tuple[FloatArray, FloatArray]:
        """Return samples of the target's surface in ``map`` (n, 3) [m] and its normals (n, 3)."""
        ...

    def first_hits(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the distance (n,) [m] to the first thing along each ray; inf for a miss."""
        ...


@dataclass(frozen=True, slots=True)
class Distances:
    """Statistics of a set of distances [m]."""

    mean: float
    median: float
    p95: float

    @staticmethod
    def of(distances: FloatArray) -> Distances:
        """Return the statistics of ``distances`` (n,)."""
        return Distances(
            float(np.mean(distances)),
            float(np.median(distances)),
            float(np.quantile(distances, 0.95)),
        )


@dataclass(frozen=True, slots=True)
class PairError:
    """How well a view was registered.

    Attributes:
        view: Index of the view.
        error: RMS over its target points of ``T_prev_new`` against the true one [m].
        pose_error: The same in the world after final alignment [m].
        odometry_error: ``error`` before registration [m].
    """

    view: int
    error: float
    pose_error: float
    odometry_error: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """A run against the truth.

    Attributes:
        coverage: Share of the coverable surface within ``COVERAGE_DISTANCE`` of the model.
        coverage_by_view: The same after the first view, the first two, and so on.
        accuracy: Distance from the model to the true surface.
        completeness: Distance from the coverable surface to the model.
        f_score: By distance [m].
        coverable_share: Share of the target's surface that can be seen from a feasible pose.
        pairs: One per registered view.
    """

    coverage: float
    coverage_by_view: tuple[float, ...]
    accuracy: Distances
    completeness: Distances
    f_score: dict[float, float]
    coverable_share: float
    pairs: tuple[PairError, ...]


@dataclass(frozen=True)
class Surface:
    """A surface by samples, each of which stands for a small flat patch.

    Attributes:
        points: The samples (n, 3) [m].
        normals: Theirs (n, 3).
        spacing: Their distance [m].
        tree: Over ``points``.
    """

    points: FloatArray
    normals: FloatArray
    spacing: float
    tree: cKDTree

    @staticmethod
    def of(points: FloatArray, normals: FloatArray, spacing: float) -> Surface:
        """Return the surface of those samples."""
        return Surface(points, normals, spacing, cKDTree(points))

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the distance (m,) [m] of ``points`` (m, 3) to the nearest samples' patches.

        The patches are flat, so that the sampling adds no distance of its own.
        """
        _, index = nearest(self.tree, points)
        return self._off(points, index)

    def within(self, points: FloatArray, distance: float) -> BoolArray:
        """Tell which ``points`` (m, 3) are no farther away than ``distance`` [m].

        Nobody looks for samples so far off that their patches cannot reach; that is quicker.
        """
        reach = (distance + self.spacing / np.sqrt(2)) * (1 + 1e-9)
        found, index = nearest(self.tree, points, reach)
        near = np.isfinite(found)
        near[near] = self._off(points[near], index[near]) <= distance
        return near

    def _off(self, points: FloatArray, index: IntArray) -> FloatArray:
        """Return the distance (m,) [m] of ``points`` (m, 3) to the patches ``index`` (m,)."""
        offset, normals = points - self.points[index], self.normals[index]
        along = np.sum(offset * normals, axis=1)
        across = np.linalg.norm(offset - along[:, None] * normals, axis=1)
        beside = np.maximum(0.0, across - self.spacing / np.sqrt(2))
        return np.asarray(np.hypot(along, beside))


@dataclass(frozen=True)
class Reference:
    """The truth of one session, worked out once for all that is measured against it.

    Attributes:
        truth: What it is from.
        poses: True ``T_map_scan`` of each view.
        T_map_world: Lays the model on the truth by its first pose alone.
        surface: The target's, in ``map``.
    """

    truth: Truth
    poses: tuple[Pose2, ...]
    T_map_world: Pose2
    surface: Surface

    @staticmethod
    def of(session: Session, truth: Truth) -> Reference:
        """Return the reference for ``session``, which has views."""
        poses = tuple(true_pose(view, truth) for view in session.views)
        T_map_world = poses[0] @ session.views[0].T_world_scan.inverse()
        return Reference(truth, poses, T_map_world, _sampled(truth))


def evaluate(session: Session, truth: Truth) -> Evaluation:
    """Compare ``session`` with the truth.

    Raises:
        ScanError: No view shows anything of the target.

    >>> evaluation = s3d.evaluate(session, truth)
    >>> 0.0 < evaluation.coverage <= 1.0, evaluation.accuracy.median < 0.01
    (True, True)
    """
    return evaluate_model(session, build_model(session), Reference.of(session, truth))


def evaluate_model(session: Session, model: Model, reference: Reference) -> Evaluation:
    """Compare ``session`` and its ``model``, not fused, with what ``reference`` holds of the truth.

    Raises:
        ScanError: No view shows anything of the target.
    """
    if not any(len(view.target) for view in session.views):
        raise ScanError("no view shows anything of the target: there is no model to evaluate")
    surface, points = reference.surface, reference.T_map_world.apply(model.points)
    coverable = coverable_surface(surface.points, surface.normals, reference.truth, session.config)
    wanted = surface.points[coverable]
    to_model, _ = nearest(cKDTree(points), wanted)
    covered = _coverage_by_view(points, model.view, len(session.views), wanted)
    return Evaluation(
        coverage=covered[-1],
        coverage_by_view=covered,
        accuracy=Distances.of(surface.distance(points)),
        completeness=Distances.of(to_model),
        f_score={
            d: _f_score(surface.distance(voxel_thin(points, d / 2)), to_model, d)
            for d in F_DISTANCES
        },
        coverable_share=float(np.mean(coverable)),
        pairs=tuple(_pair_error(k, session, reference) for k in range(1, len(session.views))),
    )


def shows_target(session: Session, truth: Truth) -> bool:
    """Tell whether ``session`` is of the target that ``truth`` knows, and not of another thing."""
    surface, _ = truth.surface(HINT_DISTANCE)
    hint = map_of_world(session, truth).apply(session.hint)
    return bool(np.median(nearest(cKDTree(surface[:, :2]), hint)[0]) <= HINT_DISTANCE)


def mesh_accuracy(mesh: Mesh, reference: Reference, rng: np.random.Generator) -> Distances:
    """Return the distances of ``MESH_SAMPLES`` points spread over ``mesh`` to the true surface.

    Raises:
        ScanError: The mesh has no triangles.
    """
    points = mesh.sample(MESH_SAMPLES, rng)
    if len(points) == 0:
        raise ScanError("the mesh has no triangles: there is nothing to evaluate")
    return Distances.of(reference.surface.distance(reference.T_map_world.apply(points)))


def map_of_world(session: Session, truth: Truth) -> Pose2:
    """Return ``T_map_world``: the model is laid on the truth by its first pose alone."""
    return true_pose(session.views[0], truth) @ session.views[0].T_world_scan.inverse()


def _coverage_by_view(
    points: FloatArray, view: IntArray, n_views: int, surface: FloatArray
) -> tuple[float, ...]:
    """Return the share of ``surface`` (n, 3) covered by the first view, the first two and so on.

    Only what the views before left open is looked at, and only nearby: the rest of a surface is
    far from a view of a part of it, and far neighbours are slow to find.
    """
    covered, shares = np.zeros(len(surface), dtype=bool), []
    for k in range(n_views):
        left = np.flatnonzero(~covered)
        distance, _ = nearest(cKDTree(points[view == k]), surface[left], 2 * COVERAGE_DISTANCE)
        covered[left] = distance <= COVERAGE_DISTANCE
        shares.append(float(np.mean(covered)))
    return tuple(shares)


def true_pose(view: View, truth: Truth) -> Pose2:
    """Return the true ``T_map_scan`` of a view, at the moment its middle line was measured."""
    image = view.observation.image
    beam = image.spec.n_beams // 2
    line = int(np.argmin(np.abs(image.yaws[:, beam])))
    stamp = float(image.stamps[line] + image.spec.beam_times[beam])
    return truth.pose_at(stamp) @ Pose2(0.0, 0.0, -float(image.yaws[line, beam]))


def displacement(points: FloatArray, a: Pose2, b: Pose2) -> float:
    """Return the RMS distance [m] of ``points`` (n, 3) mapped by ``a`` and by ``b``."""
    return rms(a.apply(points) - b.apply(points))


def _pair_error(k: int, session: Session, reference: Reference) -> PairError:
    """Return the errors of view ``k``; over all its points when it shows nothing of the target."""
    previous, view = session.views[k - 1], session.views[k]
    points = view.target.points if len(view.target) else view.sweep.points
    true = reference.poses[k - 1].inverse() @ reference.poses[k]
    registered = previous.T_world_scan.inverse() @ view.T_world_scan
    odometry = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    return PairError(
        view=k,
        error=displacement(points, registered, true),
        pose_error=displacement(
            points, reference.T_map_world @ view.T_world_scan, reference.poses[k]
        ),
        odometry_error=displacement(points, odometry, true),
    )


def _sampled(truth: Truth) -> Surface:
    """Return the true surface."""
    points, normals = truth.surface(SPACING)
    if len(points) <= MOST_SAMPLES:
        return Surface.of(points, normals, SPACING)
    spacing = SPACING * float(np.sqrt(len(points) / MOST_SAMPLES))
    return Surface.of(*truth.surface(spacing), spacing)


def surface_distance(
    points: FloatArray, surface: FloatArray, normals: FloatArray, spacing: float
) -> FloatArray:
    """Return the distance (n,) [m] of ``points`` (n, 3) to a surface sampled every ``spacing`` [m].

    For a single question; see ``Surface``.
    """
    return Surface.of(surface, normals, spacing).distance(points)


def _f_score(to_truth: FloatArray, to_model: FloatArray, distance: float) -> float:
    """Return 2PR/(P+R) at ``distance`` [m]; the model was thinned so that all parts weigh alike."""
    precision, recall = float(np.mean(to_truth <= distance)), float(np.mean(to_model <= distance))
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def coverable_surface(
    surface: FloatArray, normals: FloatArray, truth: Truth, config: Config
) -> BoolArray:
    """Tell which surface samples (n,) can be seen, noise-free, from at least one feasible pose.

    Seen means: within ``config.target`` range and window, not flatter than ``MIN_COSINE``, nothing
    in between. Feasible means: the robot fits and can get there from the spawn; for the tour
    ``front`` also: on the front side.
    """
    places = feasible_places(surface, truth, config)
    eyes = np.column_stack([places, np.full(len(places), EYE_HEIGHT)])
    unseen = np.flatnonzero(_faced(surface, normals, eyes))
    seen = np.zeros(len(surface), dtype=bool)
    for eye in eyes:
        now = unseen[visible(eye, surface[unseen], normals[unseen], truth, config)]
        seen[now] = True
        unseen = unseen[~seen[unseen]]
    return seen


def _faced(surface: FloatArray, normals: FloatArray, eyes: FloatArray) -> BoolArray:
    """Tell which samples (n,) face at least one of ``eyes`` (m, 3), whatever is in between."""
    if len(eyes) == 0:
        return np.zeros(len(surface), dtype=bool)
    corners = eyes[ConvexHull(eyes[:, :2]).vertices] if len(eyes) > 3 else eyes
    farthest = np.max(normals @ corners.T, axis=1)
    return np.asarray(farthest > np.einsum("ij,ij->i", normals, surface))


def visible(
    eye: FloatArray, surface: FloatArray, normals: FloatArray, truth: Truth, config: Config
) -> BoolArray:
    """Tell which samples (n,) the lidar sees from ``eye`` (3,)."""
    rays = surface - eye
    distance = np.linalg.norm(rays, axis=1)
    slope = np.tan(config.target.window / 2)
    seen = distance <= config.target.max_range
    seen &= np.abs(rays[:, 2]) <= slope * np.hypot(rays[:, 0], rays[:, 1])
    seen &= -np.einsum("ij,ij->i", rays, normals) > MIN_COSINE * distance
    index = np.flatnonzero(seen)
    if len(index):
        directions = rays[index] / distance[index, None]
        hits = truth.first_hits(np.broadcast_to(eye, (len(index), 3)), directions)
        seen[index] = hits >= distance[index] - HIT_TOLERANCE
    return np.asarray(seen)


def feasible_places(surface: FloatArray, truth: Truth, config: Config) -> FloatArray:
    """Return the grid places (n, 2) [m] where the robot fits, connected with its spawn."""
    low = surface[:, :2].min(axis=0) - config.target.max_range
    high = surface[:, :2].max(axis=0) + config.target.max_range
    start = np.array([truth.spawn.x, truth.spawn.y])
    first = np.floor((low - start) / POSE_STEP).astype(np.int64)
    last = np.ceil((high - start) / POSE_STEP).astype(np.int64)
    i, j = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]), indexing="ij")
    places = start + np.stack([i, j], axis=-1) * POSE_STEP
    free = _is_free(places.reshape(-1, 2), truth, config).reshape(i.shape)
    labels, _ = ndimage.label(free)
    reachable = labels == labels[-first[0], -first[1]]
    if config.tour == "front" and truth.front is not None:
        reachable &= truth.front.inverse().apply(places)[..., 0] > 0
    return np.asarray(places[reachable & free])


def _is_free(places: FloatArray, truth: Truth, config: Config) -> BoolArray:
    """Tell where (n,) nothing comes nearer than the robot's radius and the floor is below."""
    angles = np.linspace(-np.pi, np.pi, 36, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    free = np.ones(len(places), dtype=bool)
    for height in LOOK_HEIGHTS:
        centres = np.column_stack([places, np.full(len(places), height)])
        origins, directions = np.repeat(centres, len(ring), axis=0), np.tile(ring, (len(places), 1))
        hits = truth.first_hits(origins, directions).reshape(len(places), len(ring))
        free &= hits.min(axis=1) > config.motion.robot_radius
    down = np.broadcast_to((0.0, 0.0, -1.0), (len(places), 3))
    floor = truth.first_hits(np.column_stack([places, np.full(len(places), 0.3)]), down)
    return np.asarray(free & (np.abs(floor - 0.3) < config.target.floor_height))
