"""A run of a robot from the settings to the saved files, whatever ends it."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import cast

from scan3d_twin.cli.keeper import Keeper
from scan3d_twin.cli.progress import Progress, make_progress
from scan3d_twin.cli.resume import MovedCheck, Resume
from scan3d_twin.cli.save import save_run
from scan3d_twin.cli.summary import summary
from scan3d_twin.cli.versions import versions
from scan3d_twin.cli.viewing import UNWATCHED, Onlooker, Watch
from scan3d_twin.core.errors import FileError, HazardError, LinkError, ScanError
from scan3d_twin.core.observer import Observer, Observers
from scan3d_twin.core.session import Session
from scan3d_twin.recording.closed_loop import Loop, Opening, close_loop
from scan3d_twin.recording.folder import release_folder
from scan3d_twin.recording.recorder import Recorder, SerialTaps
from scan3d_twin.recording.report import Effort, Report, failure, report_json
from scan3d_twin.recording.settings import Settings
from scan3d_twin.sim.config import RobotName


@dataclass(frozen=True)
class Outcome:
    """What came of a run.

    Attributes:
        folder: Where it is saved.
        report: What it was worth.
        session: As far as it got.
        ended: What ended it before its time or makes it a failure; None if nothing did.
    """

    folder: Path
    report: Report
    session: Session
    ended: BaseException | None


def run(
    settings: Settings,
    name: str,
    opening: Opening,
    folder: Path,
    *,
    as_json: bool,
    taps: SerialTaps | None = None,
    resume: Resume | None = None,
    watch: Watch = UNWATCHED,
) -> None:
    """Digitise with the robot of ``opening``, save the results in ``folder``, print the report.

    Args:
        settings: The effective ones.
        name: Of the scene, for people.
        opening: Closed, with the wheels stopped, before anything is computed or saved.
        folder: Claimed for the results.
        as_json: Print the report as JSON.
        taps: On the serial lines of a real robot, to be recorded too.
        resume: The run to go on with, in its own folder.
        watch: Whether a live view is wanted, and how the scene looks.

    Raises:
        TwinError: The scan failed or was stopped; what was scanned by then is saved and printed.
        KeyboardInterrupt: Likewise.
    """
    outcome = run_in(settings, name, opening, folder, taps=taps, resume=resume, watch=watch)
    report = outcome.report
    print(report_json(report) if as_json else summary(report, folder), end="", flush=True)
    end(outcome)


def run_in(
    settings: Settings,
    name: str,
    opening: Opening,
    folder: Path,
    *,
    taps: SerialTaps | None = None,
    resume: Resume | None = None,
    watch: Watch = UNWATCHED,
    begun: float = 0.0,
) -> Outcome:
    """Digitise with the robot of ``opening`` and save the results in the claimed ``folder``.

    Arguments as of ``run``; ``begun`` is the robot's time from which its way counts [s].

    Raises:
        BaseException: Whatever ended it before there was anything to save.
    """
    try:
        with (
            make_progress() as progress,
            watch.onlooker(name, progress.event) as onlooker,
            recording(folder, taps, resume) as recorder,
        ):
            outcome = _digitize_and_save(
                settings, name, opening, recorder, progress, resume, onlooker, begun
            )
            onlooker.end(outcome.report["stop_reason"], progress.event)
    finally:
        release_folder(folder)
    return outcome


def end(outcome: Outcome) -> None:
    """Raise what ended the run before its time or makes it a failure, if anything did."""
    if isinstance(outcome.ended, KeyboardInterrupt):
        views = outcome.report["views"]
        raise KeyboardInterrupt(f"interrupted; finished views: {views}, saved in {outcome.folder}")
    if outcome.ended is not None:
        raise outcome.ended


@contextmanager
def recording(
    folder: Path, taps: SerialTaps | None = None, resume: Resume | None = None
) -> Iterator[Recorder]:
    """Open the session file of the run in ``folder``.

    Of a run that ends without a view it is kept only for what it tells of a robot that failed.
    """
    started = f"{datetime.now().astimezone():%Y-%m-%dT%H:%M:%S%z}"
    origin = {**versions(), "command": shlex.join(sys.argv), "started": started}
    earlier = None if resume is None else resume.recorded
    recorder = Recorder(folder, time.monotonic, origin, earlier)
    if taps is not None:
        taps.listener = recorder.on_bytes
    try:
        yield recorder
    except BaseException as error:
        recorder.abandon(keep=isinstance(error, LinkError | HazardError))
        raise


def _digitize_and_save(
    settings: Settings,
    name: str,
    opening: Opening,
    recorder: Recorder,
    progress: Progress,
    resume: Resume | None,
    onlooker: Onlooker,
    begun: float,
) -> Outcome:
    """Digitise, save and judge."""
    started, folder = time.perf_counter(), recorder.path.parent
    with opening as (robot, truth):
        name_of_base = cast(RobotName, robot.base.spec.name)
        settings = replace(settings, twin=replace(settings.twin, robot=name_of_base))
        recorder.describe(name, settings)
        watching: Observer = Observers(recorder, Keeper(folder, settings, progress))
        earlier = None
        if resume is not None:
            robot, earlier = resume.place(robot, progress.event), resume.earlier
            known = len(earlier.session.views)
            watching = Observers(watching, MovedCheck(known, watching.on_event))
        robot, watching = onlooker.attach(recorder.attach(robot), watching)
        loop = close_loop(robot, truth, settings, watching, time.perf_counter, earlier, begun)
        _finish(recorder, loop)
    effort = Effort(time.perf_counter() - started, sum(loop.plan_times), _peak_memory())
    progress.event("evaluating and saving" if truth is not None else "saving")
    picture = onlooker.picture()
    try:
        report = save_run(
            folder, name, settings, loop.session, loop.journey, effort, truth, picture
        )
    except FileError as error:  # the disk that was full before is full now
        raise (loop.ended if isinstance(loop.ended, FileError) else error) from None
    return Outcome(folder, report, loop.session, loop.ended or _failed(loop.session))


def _finish(recorder: Recorder, loop: Loop) -> None:
    """End the session file; a full disk that has ended the run has no room for an end either."""
    try:
        recorder.finish(loop.session)
    except FileError:
        recorder.close()
        if loop.ended is None:
            raise


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
