"""Which errors of a run are foretold: closed loops in a world that may be worse than assumed.

``python benchmarks/warned.py [--world harsh] [--scenes three_boxes sine_box] [--first 1030]
[--runs 12] [--config FILE] [--json]`` runs the preset ``best`` on each scene (``random`` takes a
scene for each seed) and prints a line per run on standard error. Warnings are those that need no
truth. A view is warned of by a warning of this view, or of the whole run (``error_check``,
``odometry_check``).
Keys, {value, low, high} with Wilson's 95 % interval:

* ``worse_runs``: share of the runs (with two views or more) that call their sensor or robot worse
  than assumed; in the world ``typical`` these are false alarms;
* ``above``: share of the views whose error exceeds epsilon;
* ``above_silent``: share of these of which nothing warned by the time the view was registered;
* ``above_silent_at_end``: the same by the end of the run, as its report has it;
* ``exceeded``: share of the errors above what the report says that 90 % of them stay below;
* ``exceeded_before``: the same without the factor of a run that is worse than assumed.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

from watched_loop import Watcher, run_watched

from scan3d_twin.bench.reporting.statistics import estimate_rate
from scan3d_twin.core.config import preset_options
from scan3d_twin.core.mapping.error_check import ErrorCheck, check_errors
from scan3d_twin.core.mapping.odometry_check import measure_turn_error
from scan3d_twin.core.model.pose_errors import measure_view_error
from scan3d_twin.core.session import Session
from scan3d_twin.devices.registry import Devices
from scan3d_twin.run.resolve import scene_options
from scan3d_twin.run.run_warnings import find_warnings
from scan3d_twin.run.settings import (
    build_settings,
    device_options,
    read_settings,
    world_options,
)
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene


@dataclass(frozen=True)
class Step:
    """A registered view: errors [m], and whether anything warned of it."""

    error: float
    reported: float
    factor: float
    is_above: bool
    is_warned: bool
    is_warned_at_end: bool


class WarningsWatcher(Watcher):
    """Keeps also whether each view was warned of when it was registered."""

    def __init__(self) -> None:
        self.warned: list[bool] = []

    def on_view(self, session: Session) -> None:
        """See ``Observer``."""
        super().on_view(session)
        self.warned.append(is_warned(session, len(session.views) - 1))


def is_warned(session: Session, k: int) -> bool:
    """Return whether ``session`` warns of view ``k`` or of the whole run, without the truth."""
    if check_errors(session).findings or measure_turn_error(session).is_significant:
        return True
    return any(words.startswith((f"View {k}:", f"View {k} ")) for words in find_warnings(session))


def run(
    scene_name: str, seed: int, world: str, most_views: int, config_file: Path | None
) -> tuple[ErrorCheck, list[Step]]:
    """Return what a closed loop found of its errors, and its registered views."""
    # Choose options
    scene = load_scene(f"random:{seed}" if scene_name == "random" else scene_name)
    own = {} if config_file is None else read_settings(config_file)
    loop = {**scene_options(scene), "max_views": most_views}
    settings = build_settings(
        [device_options(Devices()), world_options(world), preset_options("best"), loop, own]
    )

    # Run the loop
    config, watcher = settings.config, WarningsWatcher()
    with open_sim(scene, seed, settings.twin) as (robot, truth):
        session = run_watched(f"{scene_name} {seed}", robot, config, seed, watcher)
        if session is None:
            return ErrorCheck(), []
        errors = [measure_view_error(k, session, truth) for k in range(1, len(session.views))]

    # Compare errors and warnings
    found, steps = check_errors(session), []
    for k, error in enumerate(errors, 1):
        result = session.views[k].registration
        assert result is not None
        steps.append(
            Step(
                error,
                config.registration.calibration * result.predicted_rmse,
                found.excess,
                error > config.planning.epsilon,
                watcher.warned[k],
                is_warned(session, k),
            )
        )
    return found, steps


def main() -> None:
    """Run the loops and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--world", default="harsh")
    parser.add_argument("--scenes", nargs="+", default=["three_boxes", "sine_box"])
    parser.add_argument("--first", type=int, default=1030)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--max-views", type=int, default=12)
    parser.add_argument("--config", type=Path, help="options of the loop and the twin, TOML")
    parser.add_argument("--json", action="store_true", help="print JSON only")
    options = parser.parse_args()

    # Run all
    runs: list[tuple[ErrorCheck, list[Step]]] = []
    for scene in options.scenes:
        for seed in range(options.first, options.first + options.runs):
            found, steps = run(scene, seed, options.world, options.max_views, options.config)
            runs.append((found, steps))
            print(
                f"{scene} {seed}: readings {found.readings:.2f} shared {found.shared:.2f} odometry "
                f"{found.odometry:.2f} of {found.freedom}, {len(found.findings)} significant; "
                + " ".join(
                    f"{1e3 * s.error:.1f}/{1e3 * s.reported:.1f}{'' if s.is_warned else '?'}"
                    for s in steps
                ),
                file=sys.stderr, flush=True,
            )  # fmt: skip

    # Print the shares
    steps = [step for _, of_run in runs for step in of_run]
    above = [step for step in steps if step.is_above]
    shares = {
        "worse_runs": [bool(found.findings) for found, of_run in runs if of_run],
        "above": [step.is_above for step in steps],
        "above_silent": [not step.is_warned for step in above],
        "above_silent_at_end": [not step.is_warned_at_end for step in above],
        "exceeded": [step.error > step.factor * step.reported for step in steps],
        "exceeded_before": [step.error > step.reported for step in steps],
    }
    result = {}
    for name, told in shares.items():
        rate = estimate_rate(sum(told), len(told))
        result[name] = {"value": rate.value, "low": rate.low, "high": rate.high, "of": len(told)}
        if not options.json:
            print(f"{name:20} {rate.value:.3f} ({rate.low:.3f} to {rate.high:.3f}) of {len(told)}")
    if options.json:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
