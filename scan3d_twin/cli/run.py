"""A run of a robot from the settings to the saved files, whatever ends it."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import cast

from scan3d_twin.cli.keeper import Keeper
from scan3d_twin.cli.progress import Progress, make_progress
from scan3d_twin.cli.save import save_run
from scan3d_twin.cli.summary import summary
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.observer import Observers
from scan3d_twin.core.session import Session
from scan3d_twin.recording.closed_loop import Opening, close_loop
from scan3d_twin.recording.folder import claim_folder, free_folder, release_folder
from scan3d_twin.recording.report import Effort, Report, failure, report_json
from scan3d_twin.recording.settings import Settings
from scan3d_twin.sim.config import RobotName


def run(
    settings: Settings, name: str, opening: Opening, out: Path | None, *, as_json: bool
) -> None:
    """Digitise with the robot of ``opening``, save the results in ``out`` and print the report.

    Args:
        settings: The effective ones.
        name: Of the scene, for people.
        opening: Closed, with the wheels stopped, before anything is computed or saved.
        out: Folder for the results; None makes one under ``runs``.
        as_json: Print the report as JSON.

    Raises:
        TwinError: The scan failed or was stopped; what was scanned by then is saved and printed.
        KeyboardInterrupt: Likewise.
    """
    folder = claim_folder(_default_folder(name) if out is None else out)
    try:
        with make_progress() as progress:
            report, ended = _digitize_and_save(settings, name, opening, folder, progress)
    finally:
        release_folder(folder)
    print(report_json(report) if as_json else summary(report, folder), end="", flush=True)
    if isinstance(ended, KeyboardInterrupt):
        raise KeyboardInterrupt(
            f"interrupted; finished views: {report['views']}, saved in {folder}"
        )
    if ended is not None:
        raise ended


def _digitize_and_save(
    settings: Settings, name: str, opening: Opening, folder: Path, progress: Progress
) -> tuple[Report, BaseException | None]:
    """Return the report, and what ended the run before its time or makes it a failure."""
    started = time.perf_counter()
    with opening as (robot, truth):
        name_of_base = cast(RobotName, robot.base.spec.name)
        settings = replace(settings, twin=replace(settings.twin, robot=name_of_base))
        watching = Observers(Keeper(folder, settings, progress))
        loop = close_loop(robot, truth, settings, watching, time.perf_counter)
    effort = Effort(time.perf_counter() - started, sum(loop.plan_times), _peak_memory())
    progress.event("evaluating and saving" if truth is not None else "saving")
    report = save_run(folder, name, settings, loop.session, loop.journey, effort, truth)
    return report, loop.ended or _failed(loop.session)


def _failed(session: Session) -> ScanError | None:
    reason = failure(session)
    return ScanError(reason) if reason else None


def _peak_memory() -> float:
    """Return the most memory this process held [bytes].

    ``getrusage`` would count what the parent held before it became this program.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (peak,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    return 1024.0 * int(peak)


def _default_folder(scene: str) -> Path:
    return free_folder(Path("runs") / f"{scene}-{datetime.now():%Y%m%d-%H%M%S}")
