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
from scan3d_twin.core.mesh import Mesh
from scan3d_twin.core.model import build_model, voxel_thin
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


def evaluate(session: Session, truth: Truth) -> Evaluation:
    """Compare ``session`` with the truth.

    Raises:
        ScanError: No view shows anything of the target.
    """
    if not any(len(view.target) for view in session.views):
        raise ScanError("no view shows anything of the target: there is no model to evaluate")
    T_map_world = map_of_world(session, truth)
    model = build_model(session)
    points = T_map_world.apply(model.points)
    surface, normals, spacing = _samples(truth)
    coverable = coverable_surface(surface, normals, truth, session.config)
    to_truth = surface_distance(points, surface, normals, spacing)
    by_view = _distance_by_view(points, model.view, len(session.views), surface[coverable])
    to_model = by_view[-1]
    covered = tuple(float(np.mean(each <= COVERAGE_DISTANCE)) for each in by_view)
    return Evaluation(
        coverage=covered[-1],
        coverage_by_view=covered,
        accuracy=Distances.of(to_truth),
        completeness=Distances.of(to_model),
        f_score={
            d: _f_score(
                surface_distance(voxel_thin(points, d / 2), surface, normals, spacing), to_model, d
            )
            for d in F_DISTANCES
        },
        coverable_share=float(np.mean(coverable)),
        pairs=tuple(
            _pair_error(k, session, truth, T_map_world) for k in range(1, len(session.views))
        ),
    )


def shows_target(session: Session, truth: Truth) -> bool:
    """Tell whether ``session`` is of the target that ``truth`` knows, and not of another thing."""
    surface, _ = truth.surface(HINT_DISTANCE)
    hint = map_of_world(session, truth).apply(session.hint)
    return bool(np.median(nearest(cKDTree(surface[:, :2]), hint)[0]) <= HINT_DISTANCE)


def mesh_accuracy(
    mesh: Mesh, session: Session, truth: Truth, rng: np.random.Generator
) -> Distances:
    """Return the distances of ``MESH_SAMPLES`` points spread over ``mesh`` to the true surface.

    Raises:
        ScanError: The mesh has no triangles.
    """
    points = mesh.sample(MESH_SAMPLES, rng)
    if len(points) == 0:
        raise ScanError("the mesh has no triangles: there is nothing to evaluate")
    surface, normals, spacing = _samples(truth)
    on_truth = map_of_world(session, truth).apply(points)
    return Distances.of(surface_distance(on_truth, surface, normals, spacing))


def map_of_world(session: Session, truth: Truth) -> Pose2:
    """Return ``T_map_world``: the model is laid on the truth by its first pose alone."""
    return true_pose(session.views[0], truth) @ session.views[0].T_world_scan.inverse()


def _distance_by_view(
    points: FloatArray, view: IntArray, n_views: int, surface: FloatArray
) -> FloatArray:
    """Return the distance of ``surface`` (n, 3) to the views up to each one (n_views, n) [m]."""
    distances = np.full((n_views, len(surface)), np.inf)
    for k in range(n_views):
        if len(seen := points[view == k]):
            distances[k], _ = nearest(cKDTree(seen), surface)
    return np.asarray(np.minimum.accumulate(distances, axis=0))


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


def _pair_error(k: int, session: Session, truth: Truth, T_map_world: Pose2) -> PairError:
    """Return the errors of view ``k``; over all its points when it shows nothing of the target."""
    previous, view = session.views[k - 1], session.views[k]
    points = view.target.points if len(view.target) else view.sweep.points
    true = true_pose(previous, truth).inverse() @ true_pose(view, truth)
    registered = previous.T_world_scan.inverse() @ view.T_world_scan
    odometry = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    return PairError(
        view=k,
        error=displacement(points, registered, true),
        pose_error=displacement(points, T_map_world @ view.T_world_scan, true_pose(view, truth)),
        odometry_error=displacement(points, odometry, true),
    )


def _samples(truth: Truth) -> tuple[FloatArray, FloatArray, float]:
    """Return samples of the true surface, their normals and their distance [m]."""
    surface, normals = truth.surface(SPACING)
    if len(surface) <= MOST_SAMPLES:
        return surface, normals, SPACING
    spacing = SPACING * float(np.sqrt(len(surface) / MOST_SAMPLES))
    return *truth.surface(spacing), spacing


def surface_distance(
    points: FloatArray, surface: FloatArray, normals: FloatArray, spacing: float
) -> FloatArray:
    """Return the distance (n,) [m] of ``points`` (n, 3) to a surface sampled every ``spacing`` [m].

    The nearest sample stands for a small flat patch with its normal, so that the sampling adds no
    distance of its own.
    """
    _, index = nearest(cKDTree(surface), points)
    offset = points - surface[index]
    along = np.sum(offset * normals[index], axis=1)
    across = np.linalg.norm(offset - along[:, None] * normals[index], axis=1)
    return np.asarray(np.hypot(along, np.maximum(0.0, across - spacing / np.sqrt(2))))


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
