"""Registration of sweeps whose lines lie on no grid, beside regular ones.

``python benchmarks/irregular_lines.py --json`` prints one object {name: {value, low, high, unit,
peer, runs}}. Each ``..._vs_regular`` is the median error of the pairs of that kind divided by that
of regular pairs with the same number of readings and the same guesses, with its 95 % interval by
bootstrap over pairs; beside it ``predicted`` is the same ratio of the predicted errors, and
``bound`` that of the Cramer-Rao bounds. Where both are 1 the readings tell as much as those of
regular lines. ``registration_data.LINES`` says what the kinds are.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from cramer_rao import cramer_rao
from registration_data import LINES, Noise, Pair, pair, point_error

from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.registration.multistart import register_grids
from scan3d_twin.core.registration.pose_prior import PosePrior
from scan3d_twin.core.registration.surfels.grid import extract_surfels

SCENES, SIGMAS = ("boxes", "sine"), (0.010, 0.003)
PRIOR_XY, PRIOR_YAW = 0.02, math.radians(2.0)
FIRST_SEED = 1000
RESAMPLES = 2000
BOUNDS = 12
"""Pairs whose bounds are averaged: they differ by a few per cent only."""


def register(data: Pair) -> tuple[float, float, float]:
    """Return error and predicted error [m] of the registration of a pair, and CPU time [s].

    Both errors are infinite if it fails.
    """
    prior, began = PosePrior.planar(data.init, PRIOR_XY, PRIOR_YAW), time.thread_time()
    try:
        grids = extract_surfels(data.target), extract_surfels(data.source)
        result = register_grids(
            *grids, init_T_target_source=data.init.matrix(), prior=prior, starts=1
        )
    except RegistrationError:
        return math.inf, math.inf, time.thread_time() - began
    took = time.thread_time() - began
    points = data.source.points[np.isfinite(data.source.ranges)]
    error = point_error(points, result.T_target_source, data.truth)
    return error, result.predicted_rmse, took


def compare_medians(errors: np.ndarray, usual: np.ndarray) -> tuple[float, float, float]:
    """Return the ratio of the medians of paired errors (n,), and its 95 % interval.

    Raises:
        SystemExit: So many pairs failed that the median of some resampling is infinite.
    """
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(errors), size=(RESAMPLES, len(errors)))
    medians = np.median(errors[drawn], axis=1), np.median(usual[drawn], axis=1)
    if not np.isfinite(medians).all():
        sys.exit("about half of the registrations failed: there is no ratio of medians")
    low, high = np.quantile(medians[0] / medians[1], (0.025, 0.975))
    return float(np.median(errors) / np.median(usual)), float(low), float(high)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--runs", type=int, default=96, help="pairs of each kind")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--noise", nargs="+", type=float, default=SIGMAS, help="range noise [m]")
    arguments = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.runs)
    rows = {}
    for scene in arguments.scenes:
        for sigma in arguments.noise:
            usual, expected, least = np.zeros(0), 0.0, 0.0
            for kind, lines in LINES.items():
                pairs = [pair(scene, Noise(sigma), seed, lines=lines) for seed in seeds]
                errors, predicted, times = np.array([register(data) for data in pairs]).T
                likely = float(np.median(predicted))
                bounds = [cramer_rao(scene, sigma, s, lines) for s in seeds[:BOUNDS]]
                bound = float(np.mean(bounds))
                if kind == "regular":
                    usual, expected, least = errors, likely, bound
                value, low, high = compare_medians(errors, usual)
                name = f"{kind.replace(' ', '_')}_vs_regular_{scene}_{1e3 * sigma:.0f}mm"
                readings = np.mean([np.isfinite(data.source.ranges).sum() for data in pairs])
                rows[name] = {
                    "value": round(value, 3), "low": round(low, 3), "high": round(high, 3),
                    "unit": "ratio", "peer": "regular lines", "runs": len(pairs),
                    "predicted": round(likely / expected, 3), "bound": round(bound / least, 3),
                    "error_mm": round(1e3 * float(np.median(errors)), 4),
                    "failed": int(np.count_nonzero(np.isinf(errors))),
                    "readings": round(float(readings)),
                    "ms": round(1e3 * float(np.median(times)), 2),
                }  # fmt: skip
                print(name, rows[name], file=sys.stderr)
    if arguments.json:
        print(json.dumps(rows, indent=1))
        return
    for name, row in rows.items():
        print(
            f"{name:42s} {row['value']:6.3f} [{row['low']:.3f}, {row['high']:.3f}] "
            f"predicted {row['predicted']:.3f} bound {row['bound']:.3f}"
        )


if __name__ == "__main__":
    main()
