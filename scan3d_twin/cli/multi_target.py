"""``--targets N``: several targets in one run of the robot, each in a folder of its own."""

from __future__ import annotations

import json
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from scan3d_twin.api.run import RunOutcome, raise_if_failed, run_in_folder
from scan3d_twin.api.watch import WatchOptions
from scan3d_twin.cli.output import say
from scan3d_twin.cli.progress import make_progress
from scan3d_twin.cli.summary import summary
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.multi_target import Place, drive_back, find_places
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.recorder import SerialTaps
from scan3d_twin.run.closed_loop import RobotContext, Truth
from scan3d_twin.run.folder import claim_folder, default_folder, release_folder, write_file
from scan3d_twin.run.settings import Settings

INDEX = "targets.json"
"""File with the place and the folder of each target."""


def run_each(
    settings: Settings,
    name: str,
    opening: RobotContext,
    out: Path | None,
    count: int,
    *,
    as_json: bool,
    watch: WatchOptions,
    taps: SerialTaps | None = None,
) -> None:
    """Digitise ``count`` targets, most salient first, each into ``out``/target-K as ``run`` does.

    Fewer if there are fewer. Prints each report when its run ends; as JSON, all of them at the end.

    Raises:
        ConfigError: A target is stated too, or ``count`` is not positive.
        TwinError: A run failed; it and those before it are saved, those after it are not tried.
        KeyboardInterrupt: Likewise.
    """
    if count < 1:
        raise ConfigError(f"--targets must be at least 1, got {count}")
    if settings.run.target:
        raise ConfigError("--targets takes the most salient things, --target one; give one of them")
    folder = claim_folder(default_folder(name) if out is None else out)
    outcomes: list[RunOutcome] = []
    try:
        with opening as (robot, truth):
            start = robot.base.odometry().T_odom_base
            places = _look(robot, settings, folder, count)
            for place in places:
                if outcomes:
                    _back(robot, start, outcomes[-1])
                one = _one(settings, place, robot, truth, name, folder, len(outcomes), watch, taps)
                outcomes.append(one)
                if not as_json:
                    say(summary(one.report, one.folder), sys.stdout, end="")
                if one.ended is not None:
                    break
    finally:
        if as_json and outcomes:
            say(json.dumps({"targets": [one.report for one in outcomes]}, indent=2), sys.stdout)
        release_folder(folder)
    raise_if_failed(outcomes[-1])


def refuse_resume(folder: Path, count: int | None) -> None:
    """Refuse to resume one of several targets: its recording begins in the middle of a run.

    Raises:
        ConfigError: A ``count`` is given, or ``folder`` is of several targets or one of them.
    """
    if count is not None:
        raise ConfigError("--resume continues with the run's own target; leave out --targets")
    if (folder / INDEX).exists() or (folder.resolve().parent / INDEX).exists():
        raise ConfigError(
            f"{folder} is of a run with --targets, which cannot be resumed; its finished views are "
            "saved, and --target x,y scans one of the other targets"
        )


def _look(robot: Robot, settings: Settings, folder: Path, count: int) -> list[Place]:
    """Return the places of the targets, and write them to the folder."""
    with make_progress() as progress:
        progress.on_event(f"looking around for {count} targets")
        places = find_places(robot, settings.config, Unobserved(), count)
        progress.on_event(f"found {len(places)} of {count} targets")
    places = [(round(x, 3), round(y, 3)) for x, y in places]
    index = [{"folder": _own(k), "place_m": place} for k, place in enumerate(places)]
    write_file(folder / INDEX, json.dumps(index, indent=2) + "\n")
    return places


def _one(
    settings: Settings,
    place: Place,
    robot: Robot,
    truth: Truth | None,
    name: str,
    folder: Path,
    number: int,
    watch: WatchOptions,
    taps: SerialTaps | None,
) -> RunOutcome:
    """Digitise the target at ``place`` in the odometry frame [m]; the robot stays open."""
    x, y = place
    settings = replace(settings, run=replace(settings.run, target=f"{x},{y}"))
    opened = nullcontext((robot, truth))
    begun = robot.clock.now() if number else 0.0
    own = claim_folder(folder / _own(number))
    with make_progress() as progress:
        return run_in_folder(
            settings, name, opened, own, progress, taps=taps, watch=watch, begun=begun
        )


def _back(robot: Robot, start: Pose2, last: RunOutcome) -> None:
    with make_progress() as progress:
        progress.on_event("driving back to the start")
        drive_back(robot, start, last.session, Unobserved())


def _own(number: int) -> str:
    return f"target-{number}"
