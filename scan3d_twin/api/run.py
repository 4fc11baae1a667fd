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

from scan3d_twin.api.resume import MovedCheck, Resume
from scan3d_twin.api.save import save_run
from scan3d_twin.api.view_saver import ViewSaver
from scan3d_twin.api.watch import UNWATCHED, Onlooker, Watch
from scan3d_twin.core.errors import FileError, HazardError, LinkError, ScanError
from scan3d_twin.core.observer import Observer, Observers
from scan3d_twin.core.session import Session
from scan3d_twin.recording.recorder import Recorder, SerialTaps
from scan3d_twin.run.closed_loop import Loop, Opening, close_loop
from scan3d_twin.run.folder import release_folder
from scan3d_twin.run.report import Effort, Report, failure
from scan3d_twin.run.settings import Settings
from scan3d_twin.run.versions import versions


@dataclass(frozen=True)
class RunResult:
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


def run_in(
    settings: Settings,
    name: str,
    opening: Opening,
    folder: Path,
    observer: Observer,
    *,
    taps: SerialTaps | None = None,
    resume: Resume | None = None,
    watch: Watch = UNWATCHED,
    begun: float = 0.0,
) -> RunResult:
    """Digitise with the robot of ``opening`` and save the results in ``folder``.

    Args:
        settings: The effective ones.
        name: Name of the scene, for people.
        opening: Closed, with the wheels stopped, before anything is computed or saved.
        folder: Claimed for the results; released on every way out.
        observer: Sees every step, beside the recorder.
        taps: On the serial lines of a real robot, to be recorded too.
        resume: The run to go on with, in its own folder.
        watch: Whether a live view is wanted, and how the scene looks.
        begun: The robot's time from which its path and duration count [s].

    Returns:
        The saved outcome; an error that ended the run after its first view stands in ``ended``.

    Raises:
        BaseException: Whatever ended it before there was anything to save.
    """
    try:
        with (
            watch.onlooker(name, observer.on_event) as onlooker,
            recording(folder, taps, resume) as recorder,
        ):
            outcome = _digitize_and_save(
                settings, name, opening, recorder, observer, resume, onlooker, begun
            )
            onlooker.end(outcome.report["stop_reason"], observer.on_event)
    finally:
        release_folder(folder)
    return outcome


def end(outcome: RunResult) -> None:
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
    observer: Observer,
    resume: Resume | None,
    onlooker: Onlooker,
    begun: float,
) -> RunResult:
    """Digitise, save and judge."""
    started, folder = time.perf_counter(), recorder.path.parent
    with opening as (robot, truth):
        settings = replace(settings, twin=replace(settings.twin, robot=robot.base.spec.name))
        recorder.describe(name, settings)
        watching: Observer = Observers(recorder, ViewSaver(folder, settings), observer)
        earlier = None
        if resume is not None:
            robot, earlier = resume.place(robot, observer.on_event), resume.earlier
            known = len(earlier.session.views)
            watching = Observers(watching, MovedCheck(known, watching.on_event))
        robot, watching = onlooker.attach(recorder.attach(robot), watching)
        loop = close_loop(robot, truth, settings, watching, time.perf_counter, earlier, begun)
        _finish(recorder, loop)
    effort = Effort(time.perf_counter() - started, sum(loop.plan_times), _peak_memory())
    observer.on_event("evaluating and saving" if truth is not None else "saving")
    picture = onlooker.picture()
    try:
        report = save_run(
            folder, name, settings, loop.session, loop.journey, effort, truth, picture
        )
    except FileError as error:  # the disk that was full before is full now
        raise (loop.ended if isinstance(loop.ended, FileError) else error) from None
    return RunResult(folder, report, loop.session, loop.ended or _failed(loop.session))


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
