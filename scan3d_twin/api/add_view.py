"""``twin scan --add RUN``: one more view of a scanner that was set down by hand."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scan3d_twin.api.save import save_run
from scan3d_twin.core.digitize import drop_latest_plan, integrate
from scan3d_twin.core.errors import ConfigError, FileError, SceneError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.core.types import Observation, Pose2
from scan3d_twin.recording.load import RecordedRun, load_session, read_journey
from scan3d_twin.recording.written_session import (
    PAUSE,
    append_views,
    follow_in_time,
    read_places,
)
from scan3d_twin.run.closed_loop import Truth
from scan3d_twin.run.folder import require_own_folders
from scan3d_twin.run.report import Effort, Report
from scan3d_twin.run.resolve import load_run_scene
from scan3d_twin.run.run_warnings import describe_doubts
from scan3d_twin.run.settings import REAL_SCENE
from scan3d_twin.sim.placed_truth import Place, PlacedTruth
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.truth import Truth as TwinTruth

SPREAD, TURN = 0.5, math.radians(30.0)
"""Places are drawn within this of the first one [m], [rad]: any two are within 1 m and 60 deg."""
PLACE_STREAM = 3
"""Random stream of the places: view k draws from ``default_rng([seed, k, stream])``."""
MAX_TRIES = 100
"""Most places that are drawn to find a free one."""
MAX_PICTURE = 50_000_000
"""Largest picture of the scene that is taken over into the new report [bytes]."""

Notify = Callable[[str], None]
"""Shows a message to the user."""
Opening = AbstractContextManager[tuple[Robot, object]]
"""Opens a real robot."""


@dataclass(frozen=True)
class AddedView:
    """A run with one view more.

    Attributes:
        report: The content of its new ``report.json``.
        doubts: A sentence for each doubt about the place of the new view.
    """

    report: Report
    doubts: tuple[str, ...]


def add_view(
    folder: Path, place: Pose2 | None, opening: Callable[[], Opening], notify: Notify
) -> AddedView:
    """Take one more view and register it to the finished run in ``folder``.

    The run changes only after the view is registered and all new files are written; its earlier
    session stays beside the new one, for ``twin session undo``.

    Args:
        folder: Folder of the run.
        place: Where the stand is set down in the twin: x, y [m] and yaw [rad] from its first place;
            None draws one.
        opening: Opens the real robot, for a run of one.
        notify: Is told of progress.

    Raises:
        ConfigError: The run was scanned by a robot that drives, or ``place`` is of a real one.
        FileError: There is no finished run, or it cannot be written.
        SceneError: The stand cannot be set down there.
        RegistrationError: The view fits nowhere; the run is as it was.
        ScanError, LinkError: From the scanner; likewise.
    """
    # Load the run
    started, recorded = time.perf_counter(), load_session(folder)
    if not recorded.finished:
        raise FileError(f"the run in {folder} is not finished; finish it first, with --resume")
    k, after = len(recorded.session.views), recorded.mark.stamp + PAUSE

    # Take the view
    if recorded.settings.run.scene == REAL_SCENE:
        if place is not None:
            raise ConfigError("--place is for the twin; set a real scanner down yourself")
        notify(f"scanning view {k}")
        with opening() as (robot, _):
            return _add(recorded, _scan(robot, recorded), None, (), started, notify)
    with _open_placed(recorded, place, k) as (robot, truth):
        robot.clock.sleep(after - robot.clock.now())  # the noise goes on where it was
        notify(f"scanning view {k}")
        observation = _scan(robot, recorded)
        places = [*read_places(recorded.path), (after, truth.pose_at(robot.clock.now()))]
        spawn = load_run_scene(recorded.settings.run).spawn
        known = PlacedTruth(truth, spawn, places)
        return _add(recorded, observation, known, places, started, notify)


@contextmanager
def _open_placed(
    recorded: RecordedRun, place: Pose2 | None, k: int
) -> Iterator[tuple[Robot, TwinTruth]]:
    """Open the stand of the twin at ``place`` from its first place, or at a free one it draws."""
    run, twin = recorded.settings.run, recorded.settings.twin
    if twin.robot != "stand":
        raise ConfigError(
            f"{recorded.path.parent} was scanned by {twin.robot}, which drives; views are added to "
            "runs of --base stand, and of real scanners"
        )
    scene, rng = load_run_scene(run), np.random.default_rng([run.seed, k, PLACE_STREAM])
    tries = 1 if place is not None else MAX_TRIES
    for left in range(tries - 1, -1, -1):
        there = draw_place(rng) if place is None else place
        opening = open_sim(replace(scene, spawn=scene.spawn @ there), run.seed, twin)
        try:
            opened = opening.__enter__()
        except SceneError:
            if not left:
                raise
            continue
        try:
            yield opened
        finally:
            opening.__exit__(None, None, None)
        return


def draw_place(rng: np.random.Generator) -> Pose2:
    """Return a place within ``SPREAD`` and ``TURN`` of the first one."""
    radius, bearing = SPREAD * math.sqrt(rng.uniform()), rng.uniform(0.0, math.tau)
    return Pose2(radius * math.cos(bearing), radius * math.sin(bearing), rng.uniform(-TURN, TURN))


def _scan(robot: Robot, recorded: RecordedRun) -> Observation:
    """Return a sweep from where the scanner stands, which nobody knows."""
    yaw = robot.base.odometry().T_odom_base.yaw
    seen = sweep(robot, yaw, recorded.session.config, lambda line: None)
    (placed,) = follow_in_time([seen], recorded.mark.stamp + PAUSE)
    return replace(placed, T_odom_scan=Pose2(), touched=(), legs=(), has_odometry=False)


def _add(
    recorded: RecordedRun,
    observation: Observation,
    truth: Truth | None,
    places: Sequence[Place],
    started: float,
    notify: Notify,
) -> AddedView:
    """Register ``observation``, write the new files and return the new report."""
    # Register it to the model so far
    k = len(recorded.session.views)
    session = integrate(drop_latest_plan(recorded.session), observation)
    session = session.with_stop_reason(f"view {k} was set down by hand")
    doubts = tuple(words for words in describe_doubts(session) if words.startswith(f"View {k}"))
    for words in doubts:
        notify(f"warning: {words}")

    # Write the new files beside the run, then put them into it
    folder, name = recorded.path.parent, recorded.name
    require_own_folders(folder, folder / "views")
    notify("evaluating and saving" if truth is not None else "saving")
    effort = _add_effort(folder, time.perf_counter() - started)
    end = float(observation.image.stamps.max()) + observation.image.spec.line_period
    journey = replace(read_journey(recorded), duration=end)
    stage = _make_stage(folder)
    try:
        picture = _read_picture(folder)
        report = save_run(stage, name, recorded.settings, session, journey, effort, truth, picture)
        append_views(recorded, session, time.monotonic, places)
        _move_into(stage, folder)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
    return AddedView(report, doubts)


def _make_stage(folder: Path) -> Path:
    try:
        return Path(tempfile.mkdtemp(prefix=".add-", dir=folder))
    except OSError as error:
        raise FileError(f"cannot write to {folder}: {error.strerror or error}") from error


def _move_into(stage: Path, folder: Path) -> None:
    """Move the files of ``stage`` to the same places in ``folder``, each at once."""
    try:
        (folder / "views").mkdir(exist_ok=True)
        for path in sorted(p for p in stage.rglob("*") if p.is_file()):
            os.replace(path, folder / path.relative_to(stage))
    except OSError as error:
        raise FileError(f"cannot write to {folder}: {error.strerror or error}") from error


def _read_picture(folder: Path) -> bytes:
    """Return the picture of the scene; empty where there is none."""
    try:
        path = folder / "scene.png"
        return path.read_bytes() if path.stat().st_size <= MAX_PICTURE else b""
    except OSError:
        return b""


def _add_effort(folder: Path, seconds: float) -> Effort:
    """Return what the computer has spent on the run, ``seconds`` more than by its last report."""
    try:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        return Effort(
            float(report["wall_time_s"]) + seconds,
            float(report["plan_time_s"]),
            1e6 * float(report["peak_memory_mb"]),
        )
    except (OSError, ValueError, KeyError, TypeError):
        return Effort(seconds, 0.0, 0.0)
