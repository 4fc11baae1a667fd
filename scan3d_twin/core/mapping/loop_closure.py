"""Loop closure and global alignment: a pose graph over all pairs of views that overlap.

A chain of registrations accumulates their errors. Once around a target, the last view sees the
first again: registering the two closes the loop and reveals the accumulated error. The edges of the
graph are the odometry between neighbours and the registrations of all overlapping pairs.

The prior of each registration is removed again (``prior_removal``), so that odometry counts once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.mapping.motion_model import MotionModel, describe_move
from scan3d_twin.core.mapping.pose_graph import CHI2_GATE, PoseGraph, Solution
from scan3d_twin.core.mapping.prior_removal import remove_prior
from scan3d_twin.core.mapping.scan_matching import register_points
from scan3d_twin.core.mapping.surfel_store import Grids, SurfelStore
from scan3d_twin.core.registration import PosePrior, SurfelGrid, register
from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.pose_prior import PLANAR, predict_rmse, shift_to_target
from scan3d_twin.core.registration.surfels.extraction import X
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult
from scan3d_twin.core.viewpoints import NEARLY_ROUND, sum_turns

OVERLAP_GATE = 0.30
"""Gate of the correspondences by which overlap is measured [m]: the drift around a target before
alignment."""
MAX_LINKS_PER_VIEW = 6
"""Largest number of pairs per view beyond its neighbours, by overlap; more add no information."""
PRIOR_INFLATION = 2.0
"""Factor on the standard deviations of the graph when they become the prior of a registration;
realised errors are 0.5 to 4 times the predicted ones."""
PAIR_SEARCHES = 2
"""Number of searches for overlapping pairs: after the first, better poses reveal more of them."""
OVERLAP_STRIDE = 8
"""Stride of the surfels by which overlap is measured."""
SINGLE_BASIN_SPREAD = 0.03
"""Spread of the prior below which one basin is expected [m]: a quarter of the starts is enough."""
LOCATED_XY, LOCATED_YAW = 0.03, math.radians(1.0)
"""Prior of a view without odometry about the place where global registration has found it [m],
[rad]: ten times the error of a registration and more."""
UNKNOWN_XY, UNKNOWN_YAW = 1.0, 1.0
"""Information on such a view besides its registrations [m], [rad]: only to keep the graph
determined."""

PointsOf = Callable[[int], FloatArray]
"""Returns the points (n, 3) [m] by which a view is registered where it or the other has no
surface."""


@dataclass(frozen=True)
class Link:
    """One registered pair.

    Attributes:
        target: Index of the view registered on.
        source: Index of the view that was registered.
        chi2: Squared distance from the aligned poses in standard deviations.
        weight: 1 where it agrees with the other pairs, near 0 where it is rejected.
    """

    target: int
    source: int
    chi2: float
    weight: float


@dataclass(frozen=True)
class Alignment:
    """The poses of views that were aligned together.

    Attributes:
        views: Indices of the views that took part.
        poses: ``T_world_scan`` of each of them.
        sigmas: Standard deviations (n, 3) of x, y [m], theta [rad] of each pose, along its own
            axes.
        links: The registered pairs.
        misfits: Views that contradict the others in most of their pairs.
    """

    views: tuple[int, ...]
    poses: tuple[Pose2, ...]
    sigmas: FloatArray
    links: tuple[Link, ...]
    misfits: tuple[int, ...]


@dataclass(frozen=True)
class Edge:
    """An edge of the graph: ``T_target_source`` by two scans without a prior.

    Attributes:
        target: Index of the view registered on.
        source: Index of the view that was registered.
        T: Mean of ``T_target_source``.
        information: Its information matrix (3, 3) about the target's origin.
    """

    target: int
    source: int
    T: Pose2
    information: FloatArray


def align(session: Session, leave_out: Collection[int] = ()) -> Session:
    """Return ``session`` with all its views aligned, without those of ``leave_out``.

    Pure: the same session gives the same bits. Fewer than two views stay as they are.

    Raises:
        ConfigError: A view to leave out does not exist, or none is left.
    """
    return apply_alignment(session, solve_alignment(session, leave_out))


def apply_alignment(session: Session, alignment: Alignment) -> Session:
    """Return ``session`` with the poses of ``alignment``, without the views that took no part.

    Together with a view, the plan that led to it is dropped; with the first view, the plan that
    followed it. Panoramas stay, as what they show of the floor remains true.
    """
    # Move the views that took part
    kept = alignment.views
    dropped = [k for k in range(len(session.views)) if k not in kept]
    views = tuple(
        replace(session.views[k], T_world_scan=pose)
        for k, pose in zip(kept, alignment.poses, strict=True)
    )

    # Drop the plans of the others
    unplanned = {max(0, k - 1) for k in dropped}
    return replace(
        session,
        views=views,
        plans=tuple(plan for k, plan in enumerate(session.plans) if k not in unplanned),
        panoramas=tuple(
            (taken - sum(k < taken for k in dropped), panorama)
            for taken, panorama in session.panoramas
        ),
        misfits=tuple(kept.index(k) for k in alignment.misfits),
    )


def align_on_loop_closure(session: Session) -> Session:
    """Return ``session`` aligned if the latest view can close the loop; else as it is."""
    if session.config.alignment.mode == "off" or not _is_loop_closed(session):
        return session
    return align(session)


def align_final(session: Session) -> Session:
    """Return a finished ``session`` with its views aligned, as its configuration wants it.

    With ``alignment.misfits = drop``, views that contradict most others are left out and the rest
    is aligned again, if at least two are left.
    """
    if session.config.alignment.mode == "off":
        return session
    alignment = solve_alignment(session)
    left = len(session.views) - len(alignment.misfits)
    if session.config.alignment.misfits == "drop" and alignment.misfits and left >= 2:
        alignment = solve_alignment(session, alignment.misfits)
    return apply_alignment(session, alignment)


def _is_loop_closed(session: Session) -> bool:
    """Return whether the robot has gone far enough around to see the first view's surface again."""
    return sum_turns(view.T_world_scan for view in session.views) >= NEARLY_ROUND


def solve_alignment(session: Session, leave_out: Collection[int] = ()) -> Alignment:
    """Return the alignment of all views but those of ``leave_out``; errors as for ``align``."""
    kept = _kept_views(session, leave_out)
    views = [session.views[k] for k in kept]
    if len(views) < 2:
        return Alignment(
            tuple(kept), tuple(v.T_world_scan for v in views), np.zeros((len(kept), 3)), (), ()
        )

    # Align by the pose graph
    edges, solution = align_views(views, session.config)
    sigmas = np.sqrt(np.diagonal(solution.covariance)).reshape(-1, 3)

    # Judge the registered pairs
    found = zip(edges, solution.chi2[-len(edges) :], solution.weights[-len(edges) :], strict=True)
    links = tuple(
        Link(kept[e.target], kept[e.source], float(chi2), float(weight))
        for e, chi2, weight in (found if edges else ())
    )
    return Alignment(tuple(kept), solution.poses, sigmas, links, find_misfits(links))


def find_misfits(links: Sequence[Link]) -> tuple[int, ...]:
    """Return the views that contradict the others: most of their pairs exceed ``CHI2_GATE``."""
    wrong: dict[int, list[bool]] = {}
    for link in links:
        for view in (link.target, link.source):
            wrong.setdefault(view, []).append(link.chi2 > CHI2_GATE)
    return tuple(sorted(view for view, bad in wrong.items() if 2 * sum(bad) > len(bad)))


def _kept_views(session: Session, leave_out: Collection[int]) -> list[int]:
    """Return the indices of all views but those of ``leave_out``; errors as for ``align``."""
    missing = [k for k in leave_out if not 0 <= k < len(session.views)]
    if missing:
        raise ConfigError(
            f"there is no view {missing[0]} to leave out: the run has {len(session.views)} views, "
            "counted from 0"
        )
    kept = [k for k in range(len(session.views)) if k not in leave_out]
    if not kept and session.views:
        raise ConfigError("all views were left out: keep at least one")
    return kept


def align_views(views: Sequence[View], config: Config) -> tuple[list[Edge], Solution]:
    """Return the registered pairs of two or more views, and the solution of their pose graph."""
    learned = views if config.registration.engine == "grid" else ()
    model = MotionModel.of(learned, config)
    steps = [_expect_step(model, a, b) for a, b in pairwise(views)]
    store = SurfelStore(views, config)
    return align_grids(
        store,
        [step for step, _ in steps],
        searched=[searched for _, searched in steps],
        first=views[0].T_world_scan,
        starts=config.registration.starts,
        min_overlap=config.alignment.min_overlap,
        points=store.points,
    )


def _expect_step(model: MotionModel, before: View, after: View) -> tuple[PosePrior, PosePrior]:
    """Return the prior of a view in the one before it, and the one of their registration.

    Both are the odometry's. A view without odometry is searched where it was found.
    """
    if after.observation.has_odometry:
        prior = model.prior(*describe_move(before, after.observation))
        return prior, prior
    found = before.T_world_scan.inverse() @ after.T_world_scan
    return (
        PosePrior.planar(found, UNKNOWN_XY, UNKNOWN_YAW),
        PosePrior.planar(found, LOCATED_XY, LOCATED_YAW),
    )


def align_grids(
    grids: Grids,
    odometry: Sequence[PosePrior],
    *,
    searched: Sequence[PosePrior] | None = None,
    first: Pose2 | None = None,
    starts: int = 4,
    min_overlap: float = 0.15,
    points: PointsOf | None = None,
) -> tuple[list[Edge], Solution]:
    """Return the registered pairs of scans, and the solution of their pose graph.

    Args:
        grids: The scans in the order in which they were taken; None for one without a surface.
        odometry: Prior of each scan in the one before it, so one fewer.
        searched: Prior for the registration of these neighbours; ``odometry`` by default.
        first: Pose of the first scan; the origin by default.
        starts: Number of starting poses of each registration.
        min_overlap: Share of the smaller scan that must overlap for two scans to be registered.
        points: Points of each scan, for those without a surface; None leaves these out.
    """
    # Chain the odometry
    poses = [first or Pose2()]
    for prior in odometry:
        poses.append(poses[-1] @ Pose2.from_matrix(prior.T))

    # Register neighbours
    priors = odometry if searched is None else searched
    pair_up = partial(register_pair, grids, starts=starts, points=points)
    chain = (pair_up(k, k + 1, prior) for k, prior in enumerate(priors))
    edges = [edge for edge in chain if edge is not None]
    solution = _optimize_graph(poses, odometry, edges)

    # Register all other overlapping pairs
    tried = {(k, k + 1) for k in range(len(odometry))}
    for _ in range(PAIR_SEARCHES):
        seen = find_overlapping_pairs(grids, solution.poses, min_overlap)
        pairs = [pair for pair in seen if pair not in tried]
        tried.update(pairs)
        found = (pair_up(i, j, _graph_prior(solution, i, j)) for i, j in pairs)
        edges += [edge for edge in found if edge is not None]
        solution = _optimize_graph(solution.poses, odometry, edges)
    return edges, solution


def register_pair(
    grids: Grids, i: int, j: int, prior: PosePrior, starts: int, points: PointsOf | None
) -> Edge | None:
    """Return the edge between the scans i and j; None where they do not overlap.

    Views that show too little surface for surfels are registered by their points.

    Args:
        grids: The scans.
        i: Index of the scan registered on.
        j: Index of the scan that is registered.
        prior: Prior of scan j in i.
        starts: Number of starting poses.
        points: Points of each scan, for those without a surface; None leaves these out.
    """
    target, source = grids[i], grids[j]
    try:
        if target is not None and source is not None:
            result = _register_surfels(target, source, prior, starts)
        elif points is not None:
            result = register_points(points(i), points(j), prior)
        else:
            return None
    except RegistrationError:
        return None
    return Edge(i, j, *remove_prior(result, prior)) if result.converged else None


def _register_surfels(
    target: SurfelGrid, source: SurfelGrid, prior: PosePrior, starts: int
) -> RegistrationResult:
    """Return the registration of two scans; errors as for ``register``."""
    # Spend fewer starts on one basin
    points = source.sample(OVERLAP_STRIDE).rows[:, X] @ prior.T[:3, :3].T
    if predict_rmse(points, prior.covariance) < SINGLE_BASIN_SPREAD:
        starts = max(1, starts // 4)
    return register(target, source, prior=prior, starts=starts)


def _optimize_graph(
    poses: Sequence[Pose2], odometry: Sequence[PosePrior], edges: Sequence[Edge]
) -> Solution:
    graph = PoseGraph(poses)
    for k, prior in enumerate(odometry):
        shift = shift_to_target(prior.T)[np.ix_(PLANAR, PLANAR)]
        C = shift @ prior.covariance[np.ix_(PLANAR, PLANAR)] @ shift.T
        information = np.asarray(np.linalg.inv(C), dtype=np.float64)
        graph.add_edge(k, k + 1, Pose2.from_matrix(prior.T), information, robust=False)
    for edge in edges:
        graph.add_edge(edge.target, edge.source, edge.T, edge.information)
    return graph.optimize()


def _graph_prior(solution: Solution, i: int, j: int) -> PosePrior:
    """Return the graph's pose of view j in i as a prior about j's origin, its sigmas inflated."""
    T, C = solution.relative(i, j)
    back = np.linalg.inv(shift_to_target(T.matrix())[np.ix_(PLANAR, PLANAR)])
    C = PRIOR_INFLATION**2 * (back @ C @ back.T)
    return PosePrior.of_robot(T, (C + C.T) / 2)


def find_overlapping_pairs(
    grids: Grids, poses: Sequence[Pose2], least: float
) -> Iterator[tuple[int, int]]:
    """Yield the pairs whose overlap is at least ``least``, the largest overlap first.

    A view has at most ``MAX_LINKS_PER_VIEW`` pairs beside its neighbours.
    """
    # Measure the overlap of all pairs
    shares = [
        (share, i, j)
        for j in range(len(grids))
        for i in range(j)
        if (share := _measure_overlap(grids[i], grids[j], poses[i].inverse() @ poses[j])) >= least
    ]

    # Limit the pairs per view
    count = dict.fromkeys(range(len(grids)), 0)
    for _, i, j in sorted(shares, key=lambda row: (-row[0], row[1], row[2])):
        neighbours = j == i + 1
        if neighbours or max(count[i], count[j]) < MAX_LINKS_PER_VIEW:
            yield i, j
            count[i] += not neighbours
            count[j] += not neighbours


def _measure_overlap(a: SurfelGrid | None, b: SurfelGrid | None, T_a_b: Pose2) -> float:
    """Return the share of the smaller view's surfels that have a partner in the other view."""
    if a is None or b is None:
        return 0.0
    of_a, of_b = (len(grid.sample(OVERLAP_STRIDE).rows) for grid in (a, b))
    target, source, T = (a, b, T_a_b) if of_b <= of_a else (b, a, T_a_b.inverse())
    pairs = linearise(
        target, source, OVERLAP_STRIDE, T.matrix(), 0.0, Gate(OVERLAP_GATE, 1.0)
    ).pairs
    return pairs / max(1, min(of_a, of_b))
