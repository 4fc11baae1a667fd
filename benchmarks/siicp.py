"""Does the predicted registration error tell the true one, and at what cost?

For long surfaces, overlaps and noises a current scan is taken, the error of the registration to
come is predicted in closed form (``forecast``) and by simulated registration of what would be seen
(``simulate``), and then true second scans are taken from the candidate, displaced as a turn, a
drive and a turn displace a robot, and registered. The peer is simulated ICP as in the paper with
Open3D's point-to-point ICP, on the same scans in the same run.

``python benchmarks/siicp.py [--runs 20] [--json]`` prints {name: {value, unit, peer, runs}}:
``spearman`` and ``decision_accuracy`` (at 10 mm) of the closed form over all settings but those of
the 8 cm sine, whose slips are wrong basins (``slips_flagged``), ``pred_over_true``, and as ratios
of CPU times ``plan_vs_naive`` (all overlaps in closed form against one naive draw for each) and
``siicp10_vs_naive`` (ten draws each).
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import open3d as o3d
from registration_data import Noise, Scene, box, merge, point_error, profile, scan
from scipy.stats import spearmanr

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.motion_prior import motion_prior
from scan3d_twin.core.planning.prediction.error_prediction import ErrorPrediction
from scan3d_twin.core.planning.prediction.simulated_registration import (
    SimulatedRegistration,
    displace_prior,
)
from scan3d_twin.core.registration import SurfelGrid, extract_surfels, register
from scan3d_twin.core.registration.multistart import MIN_CONTRADICTION_GAP
from scan3d_twin.core.types import FloatArray, Pose2, RangeImage

EPSILON = 0.010
OVERLAPS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
HALF = 30.0
"""Half the width of a sweep [deg]."""
WIDTH = 2 * math.tan(math.radians(HALF))
"""What a sweep sees of a flat surface from 1 m [m]."""
SIGMAS = (0.003, 0.010)
REACH = 0.10
"""Correspondence distance of the peer [m]."""


def wave(length: float, amplitude: float) -> Scene:
    y = np.arange(2.0, -3.5, -length / 48)
    return profile(1.0 + amplitude * np.sin(math.tau * y / length), y, 0.6)


def step() -> Scene:
    return profile(np.array([1.0, 1.0, 1.08, 1.08]), np.array([3.0, -0.35, -0.35, -5.0]), 0.6)


def boxes() -> Scene:
    row = [(1.15, 0.9, 0), (1.3, 0.4, 8), (1.2, -0.1, -5), (1.1, -0.62, 6), (1.25, -1.15, -8)]
    row += [(1.15, -1.7, 4), (1.2, -2.2, -3)]
    return merge(*(box(x, y, 0.3, 0.38, 0.6, yaw) for x, y, yaw in row))


SCENES: dict[str, Callable[[], Scene]] = {
    "wall": lambda: profile(np.array([1.0, 1.0]), np.array([6.0, -8.0]), 0.6),
    "flatbox": lambda: box(1.2, -0.6, 0.4, 1.0, 0.6, 0),
    "step1": step,
    "sine60": lambda: wave(0.60, 0.05),
    "sine25": lambda: wave(0.25, 0.02),
    "sine8": lambda: wave(0.083, 0.01),
    "boxes": boxes,
}
PERIODIC = "sine8"


@cache
def config() -> Config:
    """Return the options, built once: a run has them before it plans."""
    paper = Config.preset("paper")
    return replace(
        paper,
        sweep=replace(paper.sweep, width=2 * math.radians(HALF)),
        registration=replace(
            paper.registration, engine="grid", bias_sigma=0.0, yaw_scale_sigma=0.0
        ),
        planning=replace(
            paper.planning, virtual_scan="visible", trials=10, lambda_=0.05, gamma=0.01
        ),
    )


@dataclass(frozen=True)
class Setting:
    """Scene, overlap and noise, with what was predicted and what came true, RMS [m]."""

    scene: str
    overlap: float
    sigma: float
    closed_form: float
    simulated: float
    naive: float
    true: float
    slips: float
    flagged: float


def candidate(overlap: float) -> Pose2:
    """Return O2 for a flat surface straight ahead."""
    return Pose2(0.0, -(1.0 - overlap) * WIDTH, 0.0)


def measure(name: str, overlap: float, sigma: float, runs: int) -> Setting:
    """Predict and measure the errors of ``runs`` registrations."""
    scene, settings, O2 = SCENES[name](), config(), candidate(overlap)
    prior = motion_prior(O2, settings.planning)
    predicted, simulated, naive, errors, flagged = [], [], [], [], []
    for run in range(runs):
        rng = np.random.default_rng([run, round(100 * overlap), round(1e3 * sigma), len(name)])
        first = scan(scene, Pose2(), HALF, Noise(sigma), rng)
        second = scan(scene, O2, HALF, Noise(sigma), rng)
        grid = extract_surfels(first)
        predicted.append(ErrorPrediction(grid, grid.valid, settings).error(O2))
        if run < SIMULATED:
            simulation = SimulatedRegistration(grid, grid.valid, settings, run)
            simulated += list(simulation.errors(O2, DRAWS))
        naive.append(naive_draw(first, overlap, settings, sigma, rng))
        guess = displace_prior(prior, rng.standard_normal(3))
        points = second.points[np.isfinite(second.ranges)]
        try:
            result = register(
                grid, extract_surfels(second), prior=guess, starts=settings.registration.starts
            )
            errors.append(point_error(points, result.T_target_source, O2))
            flagged.append(result.ambiguity_gap < MIN_CONTRADICTION_GAP)
        except RegistrationError:
            errors.append(point_error(points, guess.T, O2))
            flagged.append(True)
    slips = np.array(errors) > 0.03
    return Setting(
        name, overlap, sigma, quadratic(predicted), quadratic(simulated),
        quadratic(naive), quadratic(errors), float(np.mean(slips)), float(np.mean(flagged)),
    )  # fmt: skip


SIMULATED, DRAWS = 4, 5
"""Current scans on which registration is simulated, and draws on each."""


def quadratic(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(np.minimum(values, 1.0)))))


def naive_draw(
    image: RangeImage, overlap: float, settings: Config, sigma: float, rng: np.random.Generator
) -> float:
    """Return E of one draw of the paper's simulated ICP (eq. 2 to 6), noise left out [m]."""
    valid = np.isfinite(image.ranges)
    lines = np.flatnonzero(valid.any(axis=1))
    n_Q = max(2, round(overlap * len(lines)))
    Q = _points(image, valid, lines[-n_Q:])
    cut = max(1, round(settings.planning.alpha * n_Q))
    first = len(lines) - n_Q + (n_Q - cut) // 2
    Q_prime = _points(image, valid, lines[first : first + cut])
    O2 = candidate(overlap)
    x, y, _ = rng.standard_normal(3) * settings.planning.lambda_
    R_T = Pose2(x * abs(O2.x), y * abs(O2.y), 0.0)
    virtual = R_T.apply(Q_prime) + sigma * rng.standard_normal(Q_prime.shape)
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (Q, virtual)]
    registration = o3d.pipelines.registration
    criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, 100)
    estimate = registration.TransformationEstimationPointToPoint()
    found = registration.registration_icp(
        clouds[1], clouds[0], REACH, np.eye(4), estimate, criteria
    )
    T = Pose2.from_matrix(found.transformation)
    return float(np.sqrt(np.mean(np.sum(((T @ R_T).apply(Q_prime) - Q_prime) ** 2, axis=1))))


def _points(image: RangeImage, valid: np.ndarray, lines: np.ndarray) -> FloatArray:
    return np.ascontiguousarray(image.points[lines][valid[lines]])


def median_ratio(settings: list[Setting], of: str) -> float:
    return float(np.median([getattr(s, of) / s.true for s in settings]))


def agreement(settings: list[Setting], of: str) -> float:
    """Return the share of settings in which ``of`` decides on epsilon as the truth does."""
    return float(np.mean([(getattr(s, of) <= EPSILON) == (s.true <= EPSILON) for s in settings]))


def correlation(settings: list[Setting], of: str) -> float:
    pairs = [(getattr(s, of), s.true) for s in settings]
    return float(spearmanr(*np.array(pairs).T).statistic)


def cpu(
    way: Callable[[RangeImage, np.random.Generator], None],
    image: RangeImage,
    rng: np.random.Generator,
) -> float:
    """Return the CPU time of all threads [s]."""
    start = time.process_time()
    way(image, rng)
    return time.process_time() - start


def costs(runs: int) -> Iterator[list[float]]:
    """Yield CPU times [s] of closed form, ten simulated draws, the same stopped early, naive."""
    for run in range(runs):
        for name, make in SCENES.items():
            rng = np.random.default_rng([run, len(name)])
            image = scan(make(), Pose2(), HALF, Noise(0.010), rng)
            yield [cpu(way, image, rng) for way in (plan, simulate_all, simulate, naive)]


def plan(image: RangeImage, _: np.random.Generator) -> None:
    grid = extract_surfels(image)
    forecast = ErrorPrediction(grid, grid.valid, config())
    for eta in OVERLAPS:
        forecast.error(candidate(eta))


def simulate_all(image: RangeImage, _: np.random.Generator) -> None:
    simulation = _simulation(extract_surfels(image))
    for eta in OVERLAPS:
        list(simulation.errors(candidate(eta), 10))


def simulate(image: RangeImage, _: np.random.Generator) -> None:
    simulation = _simulation(extract_surfels(image))
    for eta in OVERLAPS:
        simulation.error(candidate(eta), 10)


def naive(image: RangeImage, rng: np.random.Generator) -> None:
    for eta in OVERLAPS:
        naive_draw(image, eta, config(), 0.010, rng)


def _simulation(grid: SurfelGrid) -> SimulatedRegistration:
    return SimulatedRegistration(grid, grid.valid, config(), 0)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    arguments = parser.parse_args()
    settings = []
    for name in arguments.scenes:
        for sigma in SIGMAS:
            for eta in OVERLAPS:
                settings.append(measure(name, eta, sigma, arguments.runs))
                print(describe(settings[-1]), file=sys.stderr)
    rows = figures(settings, arguments.runs) | cost_figures(max(1, arguments.runs // 5))
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(f"{name:34s} {row['value']:8.3f} {row['unit']:6s} {row['peer']} ({row['runs']})")


def describe(s: Setting) -> str:
    return (
        f"{s.scene:8s} {s.sigma * 1e3:3.0f} mm {s.overlap:.1f}: true {s.true * 1e3:7.2f}  closed "
        f"form {s.closed_form * 1e3:7.2f}  simulated {s.simulated * 1e3:7.2f}  naive "
        f"{s.naive * 1e3:7.2f} mm  slips {s.slips:.2f} flagged {s.flagged:.2f}"
    )


def figures(settings: list[Setting], runs: int) -> dict[str, dict[str, Any]]:
    """Return how well each prediction tells the truth."""
    usual = [s for s in settings if s.scene != PERIODIC]
    periodic = [s for s in settings if s.scene == PERIODIC]
    rows: dict[str, dict[str, Any]] = {}
    for label, of in (("", "closed_form"), ("_simulated", "simulated"), ("_naive", "naive")):
        for name, value, unit in (
            ("spearman", correlation(usual, of), "rank"),
            ("decision_accuracy", agreement(usual, of), "share"),
            ("pred_over_true", median_ratio(usual, of), "ratio"),
        ):
            rows[name + label] = row(value, unit, "true second scans", len(usual) * runs)
        if periodic:
            value = agreement(periodic, of)
            rows[f"sine8_decision_accuracy{label}"] = row(
                value, "share", "true second scans", len(periodic) * runs
            )
    return rows


def cost_figures(runs: int) -> dict[str, dict[str, Any]]:
    """Return the ratios of CPU times, medians over scenes and runs."""
    next(costs(1))  # compile and warm up
    closed, ten, stopped, peer_draw = np.array(list(costs(runs))).T
    count, peer = runs * len(SCENES), "open3d point-to-point SiICP, CPU"
    return {
        "plan_ms": row(1e3 * float(np.median(closed)), "ms", "CPU", count),
        "plan_vs_naive": row(float(np.median(closed / peer_draw)), "ratio", peer, count),
        "siicp10_vs_naive": row(float(np.median(ten / (10 * peer_draw))), "ratio", peer, count),
        "siicp10_stopped_vs_naive": row(
            float(np.median(stopped / (10 * peer_draw))), "ratio", peer, count
        ),
    }


def row(value: float, unit: str, peer: str, runs: int) -> dict[str, Any]:
    return {"value": round(value, 4), "unit": unit, "peer": peer, "runs": runs}


if __name__ == "__main__":
    main()
