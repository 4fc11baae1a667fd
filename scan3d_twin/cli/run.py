"""A run as the command line shows it: its progress, then its report."""

from __future__ import annotations

import sys
from pathlib import Path

from scan3d_twin.api.resume import ResumedRun
from scan3d_twin.api.run import raise_if_failed, run_in_folder
from scan3d_twin.api.watch import UNWATCHED, WatchOptions
from scan3d_twin.cli.output import say
from scan3d_twin.cli.progress import make_progress
from scan3d_twin.cli.summary import next_steps, summary
from scan3d_twin.recording.recorder import SerialTaps
from scan3d_twin.run.closed_loop import RobotContext
from scan3d_twin.run.report import report_json
from scan3d_twin.run.settings import Settings


def run(
    settings: Settings,
    name: str,
    opening: RobotContext,
    folder: Path,
    *,
    as_json: bool,
    taps: SerialTaps | None = None,
    resume: ResumedRun | None = None,
    watch: WatchOptions = UNWATCHED,
) -> None:
    """Run as ``run_in_folder`` does, show its progress and print the report, as JSON if wanted.

    Raises:
        TwinError: The scan failed or was stopped; what was scanned by then is saved and printed.
        KeyboardInterrupt: Likewise.
    """
    with make_progress() as progress:
        outcome = run_in_folder(
            settings, name, opening, folder, progress, taps=taps, resume=resume, watch=watch
        )
    report = outcome.report
    say(report_json(report) if as_json else summary(report, folder), sys.stdout, end="")
    raise_if_failed(outcome)
    if not as_json:
        say(next_steps(folder))
