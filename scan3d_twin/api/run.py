"""A run of a robot from its settings to its files, saved also when an error ends it."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from scan3d_twin.api.resume import MovedCheck, ResumedRun
from scan3d_twin.api.save import save_run
from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.api.watch import UNWATCHED, RunWatcher, WatchOptions
from scan3d_twin.core.errors import FileError, HazardError, LinkError, ScanError
from scan3d_twin.core.observer import Observer, Observers
from scan3d_twin.core.session import Session
from scan3d_twin.recording.mcap.file import RecordingError
from scan3d_twin.recording.recorder import Recorder, SerialTaps
from scan3d_twin.run.closed_loop import LoopOutcome, RobotContext, close_loop
from scan3d_twin.run.folder import release_folder
from scan3d_twin.run.report import Effort, Report, failure_reason
from scan3d_twin.run.run_warnings import AssumptionCheck
from scan3d_twin.run.settings import Settings
from scan3d_twin.run.versions import collect_versions
from scan3d_twin.viz.notebook import REPORT_HEIGHT, frame_page, render_html

SAVING, EVALUATING = "saving", "evaluating and saving"
"""What the user is told when the robot is at rest and the files of the run are written."""


@dataclass(frozen=True)
class RunOutcome:
    """The result of a run.

    Attributes:
        folder: The folder with its files.
        report: The content of ``report.json``.
        session: All views and plans up to the end.
        ended: The error that ended it early or makes it a failure; None for a success.
    """

    folder: Path
    report: Report
    session: Session
    ended: BaseException | None

    def _repr_html_(self) -> str:
        """Return the report page, or what the session shows where the page is gone."""
        try:
            page = (self.folder / "report.html").read_text(encoding="utf-8")
        except OSError:
            return render_html(self.session)
        return frame_page(page, REPORT_HEIGHT, f"Report of {self.report['scene']}")


def run_in_folder(
    settings: Settings,
    name: str,
    opening: RobotContext,
    folder: Path,
    observer: Observer,
    *,
    taps: SerialTaps | None = None,
    resume: ResumedRun | None = None,
    watch: WatchOptions = UNWATCHED,
    begun: float = 0.0,
) -> RunOutcome:
    """Digitise with the robot of ``opening`` and save the results in ``folder``.

    Args:
        settings: The effective settings.
        name: Name of the scene in reports.
        opening: Opens the robot; closed, with the wheels stopped, before anything is saved.
        folder: Claimed for the results; removed if it stays empty.
        observer: Sees every step, as the recorder does.
        taps: Taps on the serial lines of a real robot, to be recorded too.
        resume: The run to continue in its own folder; None for a new one.
        watch: Whether to serve a live view, and the picture of the scene.
        begun: Start of path and duration on the robot's clock [s].

    Returns:
        The saved result; an error that ended the run after its first view stands in ``ended``.

    Raises:
        BaseException: Whatever ended the run before its first view.
    """
    try:
        with (
            watch.open_watcher(name, observer.on_event) as watcher,
            open_recorder(folder, taps, resume) as recorder,
        ):
            outcome = _digitize_and_save(
                settings, name, opening, recorder, observer, resume, watcher, begun
            )
            watcher.finish(outcome.report["stop_reason"], observer.on_event, outcome.ended)
    finally:
        release_folder(folder)
    return outcome


def raise_if_failed(outcome: RunOutcome) -> None:
    """Raise the error that ended the run early or makes it a failure, if there is one."""
    if isinstance(outcome.ended, KeyboardInterrupt):
        views = outcome.report["views"]
        raise KeyboardInterrupt(f"interrupted; finished views: {views}, saved in {outcome.folder}")
    if outcome.ended is not None:
        raise outcome.ended


@contextmanager
def open_recorder(
    folder: Path, taps: SerialTaps | None = None, resume: ResumedRun | None = None
) -> Iterator[Recorder]:
    """Open the session file of the run in ``folder``.

    If the run ends without a view, the file is removed, unless the robot failed while it scanned:
    then it is kept for diagnosis.
    """
    started = f"{datetime.now().astimezone():%Y-%m-%dT%H:%M:%S%z}"
    origin = {**collect_versions(), "command": shlex.join(sys.argv), "started": started}
    earlier = None if resume is None else resume.recorded
    recorder = Recorder(folder, time.monotonic, origin, earlier)
    if taps is not None:
        taps.listener = recorder.on_bytes
    try:
        yield recorder
    except BaseException as error:
        kept = recorder.abandon(keep=isinstance(error, LinkError | HazardError))
        if isinstance(error, RecordingError) and not kept:
            raise error.before_first_view() from None
        raise


def _digitize_and_save(
    settings: Settings,
    name: str,
    opening: RobotContext,
    recorder: Recorder,
    observer: Observer,
    resume: ResumedRun | None,
    watcher: RunWatcher,
    begun: float,
) -> RunOutcome:
    """Digitise, save the files and return the result."""
    started, folder = time.perf_counter(), recorder.path.parent
    with opening as (robot, truth):
        settings = replace(settings, twin=replace(settings.twin, robot=robot.base.spec.name))
        recorder.describe(name, settings)
        watching: Observer = Observers(recorder, ViewSaver(folder, settings), observer)
        watching = Observers(watching, AssumptionCheck(watching.on_event))

        # Resume an earlier run
        earlier = None
        if resume is not None:
            robot, earlier = resume.place_robot(robot, observer.on_event), resume.earlier
            known = len(earlier.session.views)
            watching = Observers(watching, MovedCheck(known, watching.on_event))

        # Close the loop
        robot, watching = watcher.attach(recorder.attach(robot), watching, truth)
        loop = close_loop(robot, truth, settings, watching, time.perf_counter, earlier, begun)
        _finish(recorder, loop)

    # Save all files and the report
    effort = Effort(time.perf_counter() - started, sum(loop.plan_times), _peak_memory())
    observer.on_event(EVALUATING if truth is not None else SAVING)
    picture = watcher.picture()
    try:
        report = save_run(
            folder, name, settings, loop.session, loop.journey, effort, truth, picture
        )
    except FileError as error:  # the disk that was full before is full now
        raise (loop.ended if isinstance(loop.ended, FileError) else error) from None

    # Return it with its error
    return RunOutcome(folder, report, loop.session, loop.ended or _scan_error(loop.session))


def _finish(recorder: Recorder, loop: LoopOutcome) -> None:
    """End the session file; leave it unfinished where a full disk has ended the run."""
    try:
        recorder.finish(loop.session)
    except FileError:
        recorder.close()
        if loop.ended is None:
            raise


def _scan_error(session: Session) -> ScanError | None:
    reason = failure_reason(session)
    return ScanError(reason) if reason else None


def _peak_memory() -> float:
    """Return the largest memory of this process [bytes].

    ``getrusage`` would also count the parent's memory from before ``exec``.
    """
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    (peak,) = (line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    return 1024.0 * int(peak)
