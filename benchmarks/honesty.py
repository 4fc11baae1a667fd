"""How honest the reported errors of registration are, over closed loops on random scenes.

Each pair is a view registered on the one before it, in a closed loop of the preset ``best`` on
``random:SEED``. Development used seeds from 20000 on and ``calibrate_error.py`` 1000 to 2999; 6000
to 8519 were run by earlier builds. No estimate was changed after 8520 to 8819 were run.

With e the error of the planar pose (x, y, yaw about the target's origin), C its reported
covariance, ``error`` the RMS displacement of the target's points by e, ``predicted`` the reported
``predicted_rmse`` and ``calibrated`` that times ``registration.calibration``:

* ``nees_median``, ``nees_above_95``: median of e^T C^-1 e (ideal 2.37), and the share above 7.81,
  the 95 % quantile of chi2 with 3 degrees of freedom (ideal .05);
* ``exceeded_low``, ``_middle``, ``_high``: share of the errors above ``calibrated`` in each third
  of the pairs by ``calibrated`` (ideal .10);
* ``rank_correlation``: Spearman's, of ``predicted`` and ``error``; ``rank_ceiling``: the same for
  errors drawn from the reported covariances (mean of 20 draws): no correct covariance has more;
* ``factor``: 90 % quantile of ``error`` / ``predicted``; 1.44 to 1.65 for correct covariances;
* ``median_error_mm``, ``pairs``.

Intervals (95 %) are by bootstrap over scenes. With ``--overlap LOW HIGH`` each overlap is drawn
uniformly between both, instead of planned: the predicted errors then differ more. Jitter turns each
line of the lidar about the vertical axis, unknown to the robot: a mast that vibrates.

``python benchmarks/honesty.py [--world typical] [--jitter 0] [--scenes 300] [--jobs 1]
[--overlap 0.2 0.9] [--rows FILE] [--config FILE] [--json]``; with ``--rows`` a run that was broken
off goes on.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats
from watched_loop import Watcher, run_watched

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.model.pose_errors import find_true_pose
from scan3d_twin.core.planning.candidates.hidden_views import termination_plan
from scan3d_twin.core.planning.context import PlanningContext
from scan3d_twin.core.planning.overlap_or_default import plan_with_overlap
from scan3d_twin.core.registration.pose_prior import PLANAR
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray, Plan, Pose2
from scan3d_twin.run.resolve import scene_options
from scan3d_twin.run.settings import build_settings, read_settings, world_options
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

FIRST_SEED = 8520
"""First of the seeds after which nothing was changed."""
MOST_VIEWS = 7
"""Views of a loop: enough for a small target's tour, and no more time than needed."""
QUANTILE_95 = float(stats.chi2.ppf(0.95, 3))
CEILING_DRAWS = 20
"""Draws of the errors of all pairs; the mean of a thousand resamplings is known well enough."""
NO_ALIGNMENT = {"alignment": {"mode": "off"}}
"""Options that leave each pair as it was registered."""
RESAMPLES = 1000
"""Resamplings of the bootstrap."""


@dataclass(frozen=True)
class Pair:
    """A registered pair of views; lengths in m.

    Attributes:
        seed: Of scene and run.
        view: Index of the view.
        overlap: Chosen for it.
        planned: Error predicted before driving, with the factor.
        predicted: ``predicted_rmse`` of the registration.
        error: RMS displacement of the target's points.
        odometry: The same for the odometry.
        converged: Whether the registration says that it converged.
        degenerate: Number of degenerate directions that it reports.
        gap: Its ambiguity gap.
        nees: e^T C^-1 e.
        e: Error of x, y [m] and yaw [rad].
        C: Covariance, its upper triangle xx xy xt yy yt tt.
        M: Mean square displacement of the points per e e^T, its upper triangle.
    """

    seed: int
    view: int
    overlap: float
    planned: float
    predicted: float
    error: float
    odometry: float
    converged: int
    degenerate: int
    gap: float
    nees: float
    e: tuple[float, ...]
    C: tuple[float, ...]
    M: tuple[float, ...]


@dataclass(frozen=True)
class DrawnOverlaps:
    """Planner that draws each overlap between ``low`` and ``high``."""

    low: float
    high: float

    def plan(self, session: Session, rng: np.random.Generator) -> Plan:
        """Return the viewpoint for an overlap drawn uniformly."""
        context = PlanningContext(session)
        if plan := termination_plan(context):
            return plan
        overlap = float(rng.uniform(self.low, self.high))
        return plan_with_overlap(context, overlap, f"drawn overlap: {overlap:.0%}")


def run_scene(
    seed: int,
    world: str,
    jitter: float,
    config_file: Path | None,
    overlap: Sequence[float] | None = None,
) -> tuple[int, list[Pair]]:
    """Return the seed and the pairs of a closed loop on its scene; none if it failed early."""
    # Choose options
    scene, watcher = load_scene(f"random:{seed}"), Watcher()
    loop = {**scene_options(scene), "max_views": MOST_VIEWS}
    own = {} if config_file is None else read_settings(config_file)
    sway = {"lidar": {"sway": math.radians(jitter)}} if jitter > 0 else {}
    settings = build_settings(
        [preset_options("best"), world_options(world), loop, NO_ALIGNMENT, sway, own]
    )

    # Run the loop
    config = settings.config
    with open_sim(scene, seed, settings.twin) as (robot, truth):
        planner = DrawnOverlaps(*overlap) if overlap else None
        session = run_watched(f"random:{seed}", robot, config, seed, watcher, planner)
        if session is None:
            return seed, []
        poses = [find_true_pose(view, truth) for view in session.views]
    return seed, [_compare(session, k, poses, seed) for k in range(1, len(session.views))]


def _compare(session: Session, k: int, poses: Sequence[Pose2], seed: int) -> Pair:
    """Return the pair of view ``k`` and the one before, given the true poses of all views."""
    view, previous, plan = session.views[k], session.views[k - 1], session.plans[k - 1]
    result = view.registration
    assert result is not None

    # Error of the pose, about the target's origin
    true = poses[k - 1].inverse() @ poses[k]
    found = Pose2.from_matrix(result.T_target_source)
    off = found @ true.inverse()
    e = np.array([off.x, off.y, off.yaw])
    C = result.covariance[np.ix_(PLANAR, PLANAR)]

    # Displacement of the target's points
    M = _displacement_moments(view, true)
    move = previous.observation.T_odom_scan.inverse() @ view.observation.T_odom_scan
    by_odometry = move @ true.inverse()
    o = np.array([by_odometry.x, by_odometry.y, by_odometry.yaw])
    half = np.triu_indices(3)
    return Pair(
        seed, k, plan.overlap, plan.predicted_rmse, result.predicted_rmse,
        math.sqrt(e @ M @ e), math.sqrt(o @ M @ o), int(result.converged),
        len(result.degenerate_directions), result.ambiguity_gap,
        float(e @ np.linalg.solve(C, e)), tuple(e), tuple(C[half]), tuple(M[half]),
    )  # fmt: skip


def _displacement_moments(view: View, true: Pose2) -> FloatArray:
    """Return M (3, 3): points of the target move by sqrt(e^T M e) in the RMS, to first order."""
    points = view.target.points if len(view.target) else view.sweep.points
    x, y = true.apply(points)[:, :2].T
    J = np.stack([[np.ones_like(x), np.zeros_like(x), -y], [np.zeros_like(x), np.ones_like(x), x]])
    return np.asarray(np.einsum("akn,aln->kl", J, J) / len(x))


Sample = Sequence[Pair]


def measure(pairs: Sample, calibration: float) -> dict[str, float]:
    """Return all figures of ``pairs``."""
    predicted, error, nees = (
        np.array([getattr(p, name) for p in pairs]) for name in ("predicted", "error", "nees")
    )
    thirds = np.array_split(np.argsort(predicted, kind="stable"), 3)
    exceeded = [float(np.mean(error[third] > calibration * predicted[third])) for third in thirds]
    return {
        "nees_median": float(np.median(nees)),
        "nees_above_95": float(np.mean(nees > QUANTILE_95)),
        "exceeded_low": exceeded[0],
        "exceeded_middle": exceeded[1],
        "exceeded_high": exceeded[2],
        "rank_correlation": float(stats.spearmanr(predicted, error).statistic),
        "rank_ceiling": _rank_ceiling(pairs, predicted),
        "factor": float(np.quantile(error / predicted, 0.9)),
        "median_error_mm": 1e3 * float(np.median(error)),
    }


def _rank_ceiling(pairs: Sample, predicted: FloatArray) -> float:
    """Return the mean rank correlation of ``predicted`` with errors drawn from the covariances."""
    rng = np.random.default_rng(0)
    C, M = (np.array([_unfold(getattr(p, name)) for p in pairs]) for name in "CM")
    values, vectors = np.linalg.eigh(C)
    half = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    found = []
    for _ in range(CEILING_DRAWS):
        e = np.einsum("nij,nj->ni", half, rng.standard_normal((len(C), 3)))
        drawn = np.sqrt(np.einsum("ni,nij,nj->n", e, M, e))
        found.append(stats.spearmanr(predicted, drawn).statistic)
    return float(np.mean(found))


def _unfold(upper: tuple[float, ...]) -> FloatArray:
    """Return the symmetric matrix (3, 3) with this upper triangle."""
    full = np.zeros((3, 3))
    full[np.triu_indices(3)] = upper
    return full + np.triu(full, 1).T


def bootstrap(
    pairs: Sample, figures: Callable[[Sample], dict[str, float]]
) -> dict[str, dict[str, float]]:
    """Return each figure with its 95 % interval, by drawing scenes with replacement."""
    value = figures(pairs)
    scenes: dict[int, list[Pair]] = {}
    for pair in pairs:
        scenes.setdefault(pair.seed, []).append(pair)
    of_scene, rng = list(scenes.values()), np.random.default_rng(0)
    rows = []
    for _ in range(RESAMPLES):
        drawn = rng.integers(len(of_scene), size=len(of_scene))
        rows.append(figures([pair for k in drawn for pair in of_scene[k]]))
    return {
        name: {
            "value": value[name],
            "low": float(np.quantile([row[name] for row in rows], 0.025)),
            "high": float(np.quantile([row[name] for row in rows], 0.975)),
        }
        for name in value
    }


def read_rows(path: Path) -> list[tuple[int, list[Pair]]]:
    """Return the scenes of a file that ``write_scene`` wrote; none if there is no file."""
    if not path.exists():
        return []
    scenes = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [(scene["seed"], [Pair(**pair) for pair in scene["pairs"]]) for scene in scenes]


def write_scene(path: Path, seed: int, pairs: list[Pair]) -> None:
    """Append a scene's pairs as a line of JSON."""
    line = json.dumps({"seed": seed, "pairs": [asdict(pair) for pair in pairs]})
    with path.open("a", encoding="utf-8") as file:
        file.write(line + "\n")


def main() -> None:
    """Run, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="typical")
    parser.add_argument("--jitter", type=float, default=0.0, help="of each line's yaw [deg]")
    parser.add_argument("--first", type=int, default=FIRST_SEED)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--overlap", nargs=2, type=float, metavar=("LOW", "HIGH"), help="draw each overlap"
    )
    parser.add_argument("--config", type=Path, help="a TOML file with more options")
    parser.add_argument("--rows", type=Path, help="append each scene's pairs; go on from these")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()

    # Run the scenes that the file lacks
    wanted = range(arguments.first, arguments.first + arguments.scenes)
    found = dict(read_rows(arguments.rows)) if arguments.rows else {}
    missing = [seed for seed in wanted if seed not in found]
    run = partial(
        run_scene,
        world=arguments.world,
        jitter=arguments.jitter,
        config_file=arguments.config,
        overlap=arguments.overlap,
    )
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for seed, made in pool.map(run, missing):
            found[seed] = made
            print(f"random:{seed}: {len(made)} pairs", file=sys.stderr)
            if arguments.rows:
                write_scene(arguments.rows, seed, made)

    # Measure and print
    pairs = [pair for seed in wanted for pair in found[seed]]
    calibration = build_settings([]).config.registration.calibration
    rows: dict[str, dict[str, Any]] = {
        **bootstrap(pairs, partial(measure, calibration=calibration)),
        "pairs": {"value": len(pairs), "low": len(pairs), "high": len(pairs)},
    }
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:18s} {row['value']:8.3f} [{row['low']:.3f}, {row['high']:.3f}]")


if __name__ == "__main__":
    main()
