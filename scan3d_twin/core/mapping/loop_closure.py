"""Global alignment: all views at once, by a pose graph over every two that overlap.

A chain of views adds up the errors of its links; around a target the last view sees the first
again, which says by how much. The graph's edges are the odometry between neighbours and the
registrations of all pairs that overlap. A registration is maximum a posteriori: with the prior
(x0, L0) it is based on it is at x, of information L. What the scans alone say is taken out of it,

    L_d = L - L0,   x_d = x + L_d^+ L0 (x - x0),

so that odometry counts once. Where several basins fit, the pair knows little more than its prior:
the less the gap tells them apart, the more of the prior's covariance is added to its own.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError, RegistrationError
from scan3d_twin.core.mapping.pose_graph import GATE, PoseGraph, Solution
from scan3d_twin.core.mapping.scan_matching import motion_prior, odometry_scale
from scan3d_twin.core.mapping.surfel_store import Prepared
from scan3d_twin.core.registration import PosePrior, SurfelGrid, register
from scan3d_twin.core.registration.multistart import MIN_CONTRADICTION_GAP
from scan3d_twin.core.registration.point_to_plane import Gate, linearise
from scan3d_twin.core.registration.pose_prior import PLANAR, predict_rmse, shift_to_target
from scan3d_twin.core.registration.surfels import X
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray, Pose2, RegistrationResult, wrap

SEARCH = 0.30
"""Overlap is looked for with a gate this wide [m]: the drift around a target before alignment."""
MOST_LINKS = 6
"""Pairs per view beyond its neighbours, the most overlapping first; more repeat what these say."""
OPTIMISM = 2.0
"""Standard deviations of chained registrations are multiplied by this when they become the prior of
another one; realised errors are 0.5 to 4 times the predicted ones."""
NEARLY_ROUND = math.radians(240.0)
"""Turn since the first view after which the latest may see the same again; three sides of a box
are 270 deg."""
ROUNDS = 2
"""Searches for pairs: after the first, views lie where more can be found."""
KNOWN = 0.05
"""Directions in which the scans say less than this share of what the prior does are left out."""
STRIDE = 8
"""Every so manieth surfel is looked at when overlap is counted."""
CERTAIN = 0.03
"""A prior that lets the source move by less than this has one basin [m]: a quarter of the starts
will do, in case it does not."""


Grids = Sequence[SurfelGrid | None] | Prepared
"""Surfels of each view; None for one without a surface."""


@dataclass(frozen=True)
class Link:
    """One registered pair.

    Attributes:
        target: Index of the view registered on.
        source: Index of the view that was registered.
        chi2: How far it lies from the aligned views, squared in standard deviations.
        weight: 1 where it agrees with the rest, near 0 where it was overruled.
    """

    target: int
    source: int
    chi2: float
    weight: float


@dataclass(frozen=True)
class Alignment:
    """Views aligned all at once.

    Attributes:
        views: Indices of the views that took part.
        poses: ``T_world_scan`` of each of them.
        sigmas: Standard deviations (n, 3) of x, y [m], theta [rad] of each, along its own axes.
        links: Registered pairs.
        misfits: Views that contradict the others in most of their pairs.
    """

    views: tuple[int, ...]
    poses: tuple[Pose2, ...]
    sigmas: FloatArray
    links: tuple[Link, ...]
    misfits: tuple[int, ...]


@dataclass(frozen=True)
class Edge:
    """What two scans alone say of ``T_target_source``: mean and information (3, 3) about target."""

    target: int
    source: int
    T: Pose2
    information: FloatArray


def align(session: Session, leave_out: Collection[int] = ()) -> Session:
    """Return ``session`` with all views placed at once; those of ``leave_out`` are dropped.

    Pure: the same session gives the same bits. Fewer than two views stay as they are.

    Raises:
        ConfigError: A view to leave out does not exist, or none is left.
    """
    return apply_alignment(session, solve(session, leave_out))


def apply_alignment(session: Session, alignment: Alignment) -> Session:
    """Return ``session`` with its views where ``alignment`` has them, without the others.

    With a view goes the plan that led to it, with the first one the plan made after it. Looks
    around stay, as what they saw of the floor does.
    """
    kept = alignment.views
    dropped = [k for k in range(len(session.views)) if k not in kept]
    views = tuple(
        replace(session.views[k], T_world_scan=pose)
        for k, pose in zip(kept, alignment.poses, strict=True)
    )
    unplanned = {max(0, k - 1) for k in dropped}
    return replace(
        session,
        views=views,
        plans=tuple(plan for k, plan in enumerate(session.plans) if k not in unplanned),
        panoramas=tuple(
            (taken - sum(k < taken for k in dropped), look) for taken, look in session.panoramas
        ),
        misfits=tuple(kept.index(k) for k in alignment.misfits),
    )


def align_on_loop_closure(session: Session) -> Session:
    """Return ``session`` aligned if the latest view closes the contour; else as it is."""
    if session.config.alignment.mode == "off" or not _turned_round(session):
        return session
    return align(session)


def align_final(session: Session) -> Session:
    """Return a finished ``session`` aligned as its configuration wants it.

    With ``alignment.misfits`` drop, views that contradict most others are left out and the rest is
    aligned again, as long as two are left.
    """
    if session.config.alignment.mode == "off":
        return session
    alignment = solve(session)
    left = len(session.views) - len(alignment.misfits)
    if session.config.alignment.misfits == "drop" and alignment.misfits and left >= 2:
        alignment = solve(session, alignment.misfits)
    return apply_alignment(session, alignment)


def _turned_round(session: Session) -> bool:
    """Tell whether the robot has gone far enough around the target to see the first view again."""
    yaws = [view.T_world_scan.yaw for view in session.views]
    return sum(wrap(b - a) for a, b in pairwise(yaws)) >= NEARLY_ROUND


def solve(session: Session, leave_out: Collection[int] = ()) -> Alignment:
    """Return how all views but those of ``leave_out`` lie together; errors as for ``align``."""
    kept = _kept(session, leave_out)
    views = [session.views[k] for k in kept]
    if len(views) < 2:
        return Alignment(
            tuple(kept), tuple(v.T_world_scan for v in views), np.zeros((len(kept), 3)), (), ()
        )
    edges, solution = align_views(views, session.config)
    sigmas = np.sqrt(np.diagonal(solution.covariance)).reshape(-1, 3)
    found = zip(edges, solution.chi2[-len(edges) :], solution.weights[-len(edges) :], strict=True)
    links = tuple(
        Link(kept[e.target], kept[e.source], float(chi2), float(weight))
        for e, chi2, weight in (found if edges else ())
    )
    return Alignment(tuple(kept), solution.poses, sigmas, links, misfits(links))


def misfits(links: Sequence[Link]) -> tuple[int, ...]:
    """Return the views that contradict the others: most of their pairs exceed chi2's ``GATE``."""
    wrong: dict[int, list[bool]] = {}
    for link in links:
        for view in (link.target, link.source):
            wrong.setdefault(view, []).append(link.chi2 > GATE)
    return tuple(sorted(view for view, bad in wrong.items() if 2 * sum(bad) > len(bad)))


def _kept(session: Session, leave_out: Collection[int]) -> list[int]:
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
    """Return the registered pairs of two views or more, and how all of them lie together."""
    scale = odometry_scale(views, config) if config.registration.engine == "grid" else 1.0
    return align_grids(
        Prepared(views, config),
        [_odometry(a, b, config, scale) for a, b in pairwise(views)],
        first=views[0].T_world_scan,
        starts=config.registration.starts,
        min_overlap=config.alignment.min_overlap,
    )


def align_grids(
    grids: Grids,
    odometry: Sequence[PosePrior],
    *,
    first: Pose2 | None = None,
    starts: int = 4,
    min_overlap: float = 0.15,
) -> tuple[list[Edge], Solution]:
    """Return the registered pairs of scans, and how all of them lie together.

    Args:
        grids: The scans in the order they were taken; None for one without a surface.
        odometry: Of each scan in the one before it, so one fewer.
        first: Where the first scan lies; the origin by default.
        starts: Of each registration.
        min_overlap: Two scans are registered when so much of the smaller one finds a partner.
    """
    poses = [first or Pose2()]
    for prior in odometry:
        poses.append(poses[-1] @ Pose2.from_matrix(prior.T))
    chain = (register_pair(grids, k, k + 1, prior, starts) for k, prior in enumerate(odometry))
    edges = [edge for edge in chain if edge is not None]
    solution = _solve(poses, odometry, edges)
    tried = {(k, k + 1) for k in range(len(odometry))}
    for _ in range(ROUNDS):
        seen = overlapping(grids, solution.poses, min_overlap)
        pairs = [pair for pair in seen if pair not in tried]
        tried.update(pairs)
        found = (register_pair(grids, i, j, _prior(solution, i, j), starts) for i, j in pairs)
        edges += [edge for edge in found if edge is not None]
        solution = _solve(solution.poses, odometry, edges)
    return edges, solution


def _odometry(previous: View, view: View, config: Config, scale: float) -> PosePrior:
    move = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    return motion_prior(move, config.planning, scale)


def register_pair(grids: Grids, i: int, j: int, prior: PosePrior, starts: int) -> Edge | None:
    """Return what the scans i and j say of each other; None where they do not overlap."""
    target, source = grids[i], grids[j]
    if target is None or source is None:
        return None
    points = source.sample(STRIDE).rows[:, X] @ prior.T[:3, :3].T
    if predict_rmse(points, prior.covariance) < CERTAIN:
        starts = max(1, starts // 4)
    try:
        result = register(target, source, prior=prior, starts=starts)
    except RegistrationError:
        return None
    if not result.converged:
        return None
    return Edge(i, j, *scans_alone(result, prior))


def scans_alone(result: RegistrationResult, prior: PosePrior) -> tuple[Pose2, FloatArray]:
    """Return mean and information (3, 3) of what the scans say without the prior.

    About the target's origin along its axes; the equations are at the module's head. In the metric
    of the prior, L0 = A^T A, the eigenvalues of A^-T L A^-1 are 1 + what the scans add.
    """
    shift = shift_to_target(result.T_target_source)[np.ix_(PLANAR, PLANAR)]
    rows = list(PLANAR)
    deviation = shift @ prior.deviation(result.T_target_source)[rows]
    half = np.linalg.cholesky(shift @ prior.covariance[np.ix_(PLANAR, PLANAR)] @ shift.T)
    values, vectors = np.linalg.eigh(half.T @ result.information[np.ix_(PLANAR, PLANAR)] @ half)
    added = np.where(values - 1.0 > KNOWN, values - 1.0, 0.0)
    along = vectors.T @ np.linalg.solve(half, deviation)
    correction = half @ vectors @ np.divide(along, added, out=np.zeros(3), where=added > 0)
    doubt = max(0.0, 1.0 - result.ambiguity_gap / MIN_CONTRADICTION_GAP)
    added = added / (1.0 + doubt * added)
    back = np.linalg.solve(half.T, vectors)
    T = Pose2.from_matrix(result.T_target_source)
    moved = Pose2(float(correction[0]), float(correction[1]), float(correction[2])) @ T
    return moved, (back * added) @ back.T


def _solve(
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


def _prior(solution: Solution, i: int, j: int) -> PosePrior:
    """Return what the graph knows of view j in i, less sure of it, about j's origin."""
    T, C = solution.relative(i, j)
    back = np.linalg.inv(shift_to_target(T.matrix())[np.ix_(PLANAR, PLANAR)])
    C = OPTIMISM**2 * (back @ C @ back.T)
    return PosePrior.of_robot(T, (C + C.T) / 2)


def overlapping(grids: Grids, poses: Sequence[Pose2], least: float) -> Iterator[tuple[int, int]]:
    """Yield the pairs that share ``least`` or more, best first, at most ``MOST_LINKS`` per view."""
    shares = [
        (share, i, j)
        for j in range(len(grids))
        for i in range(j)
        if (share := _overlap(grids[i], grids[j], poses[i].inverse() @ poses[j])) >= least
    ]
    count = dict.fromkeys(range(len(grids)), 0)
    for _, i, j in sorted(shares, key=lambda row: (-row[0], row[1], row[2])):
        neighbours = j == i + 1
        if neighbours or max(count[i], count[j]) < MOST_LINKS:
            yield i, j
            count[i] += not neighbours
            count[j] += not neighbours


def _overlap(a: SurfelGrid | None, b: SurfelGrid | None, T_a_b: Pose2) -> float:
    """Return the share of the smaller view's surfels that find one of the other's."""
    if a is None or b is None:
        return 0.0
    of_a, of_b = (len(grid.sample(STRIDE).rows) for grid in (a, b))
    target, source, T = (a, b, T_a_b) if of_b <= of_a else (b, a, T_a_b.inverse())
    pairs = linearise(target, source, STRIDE, T.matrix(), 0.0, Gate(SEARCH, 1.0)).pairs
    return pairs / max(1, min(of_a, of_b))
