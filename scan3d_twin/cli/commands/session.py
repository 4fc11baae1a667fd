"""``twin session``: look at, repair and change what a run recorded."""

from __future__ import annotations

import json as json_module
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import App

from scan3d_twin.cli.output import say
from scan3d_twin.core.errors import FileError

if TYPE_CHECKING:
    from scan3d_twin.recording.load import Beginning, RecordedRun
    from scan3d_twin.recording.repair.recover import Recovery
    from scan3d_twin.run.report import Report

app = App(
    name="session", help_format="markdown", help="Look at, repair and change what a run recorded."
)


@app.command
def info(folder: Path, /, *, json: bool = False) -> None:
    """Show what a session holds, even while its run goes on.

    Args:
        folder: Folder of a run, or its session file.
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.cli.summary import count
    from scan3d_twin.recording.load import NoViewError, load_session, read_beginning

    try:
        found = _facts(load_session(folder))
    except NoViewError:
        found = _first_facts(read_beginning(folder))
    if json:
        print(json_module.dumps(found, indent=2))
        return
    lines = [
        f"{found['path']}: {found['state']}, {found['size_mb']} MB",
        f"{found['name']}, seed {found['seed']}, planner {found['planner']}",
        f"scan3d_twin {found['version']}, {found['started']}: {found['command']}",
        f"{count(len(found['views']), 'view')}, {found['lines']} lines, "
        f"{found['duration_s']:.1f} s, {found['path_m']:.1f} m; "
        f"{found['stop_reason'] or 'did not end'}",
    ]
    for k, view in enumerate(found["views"]):
        placed = "registered" if view["registered"] else "NOT registered"
        placed = placed if k else "defines the frame world"
        lines.append(f"view {k}: {view['lines']} lines, {view['target_points']} points, {placed}")
    say("\n".join(lines), sys.stdout)


def _facts(recorded: RecordedRun) -> dict[str, Any]:
    from scan3d_twin.recording.load import read_lines

    session, mark, origin = recorded.session, recorded.mark, recorded.provenance
    state = "finished" if recorded.finished else "going on" if recorded.running else "killed"
    results = [view.registration for view in session.views]
    return {
        "path": str(recorded.path),
        "state": state,
        "size_mb": round(recorded.path.stat().st_size / 1e6, 1),
        "name": recorded.name,
        "seed": session.seed,
        "planner": session.config.planner,
        "version": session.version,
        "started": origin.get("started", ""),
        "command": origin.get("command", ""),
        "versions": {k: v for k, v in origin.items() if k not in ("started", "command")},
        "stop_reason": session.stop_reason,
        "duration_s": round(mark.stamp, 3),
        "path_m": round(mark.path, 3),
        "lines": sum(1 for _ in read_lines(recorded.path)),
        "plans": len(session.plans),
        "views": [
            {
                "lines": view.observation.image.n_lines,
                "target_points": len(view.target),
                "registered": result is None or result.converged,
            }
            for view, result in zip(session.views, results, strict=True)
        ],
    }


def _first_facts(begun: Beginning) -> dict[str, Any]:
    """Return the facts of a run without a finished view."""
    from scan3d_twin.recording.load import read_lines
    from scan3d_twin.recording.mcap.recovering_reader import is_finished

    state = "going on" if begun.running else "finished" if is_finished(begun.path) else "killed"
    settings, origin = begun.settings, begun.provenance
    return {
        "path": str(begun.path),
        "state": state,
        "size_mb": round(begun.path.stat().st_size / 1e6, 1),
        "name": begun.name,
        "seed": settings and settings.run.seed,
        "planner": settings and settings.config.planner,
        "version": settings and settings.run.version,
        "started": origin.get("started", ""),
        "command": origin.get("command", ""),
        "versions": {k: v for k, v in origin.items() if k not in ("started", "command")},
        "stop_reason": "no view was finished",
        "duration_s": round(begun.duration, 3),
        "path_m": 0.0,
        "lines": sum(1 for _ in read_lines(begun.path)),
        "plans": 0,
        "views": [],
    }


@app.command
def recover(folder: Path, /, *, json: bool = False) -> None:
    """Repair the session file of a run that was killed, or a damaged one.

    `twin` itself reads the file of a killed run as it is; other programs need it repaired. The
    new file holds everything but the damaged parts; the old one stays beside it.

    Args:
        folder: Folder of a run.
        json: Print one JSON document instead of a line.
    """
    from scan3d_twin.recording.repair.recover import recover_session

    found = recover_session(folder, time.monotonic)
    if json:
        facts = {
            "path": str(found.path),
            "kept": found.backup and str(found.backup),
            "views_before": found.before,
            "views_after": found.after,
            "views_recorded": found.recorded,
            "lost_messages": found.lost_messages,
            "lost_settings": found.lost_settings,
        }
        print(json_module.dumps(facts))
    else:
        say(_recovered(found), sys.stdout)
    if found.after < found.recorded:
        raise FileError(
            f"{found.recorded - found.after} of {found.recorded} recorded views were in the "
            "damaged part and are lost"
        )


def _recovered(found: Recovery) -> str:
    """Return what a repair did, in words."""
    from scan3d_twin.cli.summary import count

    if found.backup is None:
        return f"{found.path} is intact: nothing to do"
    lost = (
        "an unknown number of messages"
        if found.lost_messages is None
        else count(found.lost_messages, "message")
    )
    settings = "; its options are lost, too" if found.lost_settings else ""
    return (
        f"{found.path} is repaired: {count(found.before, 'view')} before, {found.after} after, "
        f"{lost} lost{settings}; the old file: {found.backup}"
    )


@app.command(name="drop-view")
def drop_view(folder: Path, view: int, /, *, json: bool = False) -> None:
    """Remove a view and register the others again; `twin session undo` takes it back.

    Args:
        folder: Folder of a run.
        view: Number of the view, counted from 0 as in the report.
        json: Print the new report as JSON.
    """
    from scan3d_twin.recording.repair.edit import drop_view as drop

    _show(folder, drop(folder, view, time.monotonic), as_json=json)


@app.command
def undo(folder: Path, /, *, json: bool = False) -> None:
    """Take back the last drop-view, recover, --resume or scan --add; a second undo redoes it.

    Args:
        folder: Folder of a run.
        json: Print the report as JSON.
    """
    from scan3d_twin.recording.repair.edit import undo_last_change as take_back

    _show(folder, take_back(folder), as_json=json)


def _show(folder: Path, recorded: RecordedRun, *, as_json: bool) -> None:
    from scan3d_twin.cli.summary import summary
    from scan3d_twin.run.report import report_json

    report = _save_again(recorded)
    say(report_json(report) if as_json else summary(report, folder), sys.stdout, end="")


def _save_again(recorded: RecordedRun) -> Report:
    """Write the model and the report of a changed session; in the twin, against the truth."""
    from scan3d_twin.api.save import save_run
    from scan3d_twin.cli.progress import make_progress
    from scan3d_twin.recording.load import read_commands, read_journey
    from scan3d_twin.recording.resume import reenact
    from scan3d_twin.recording.written_session import read_places
    from scan3d_twin.run.settings import REAL_SCENE

    run, mark, folder = recorded.settings.run, recorded.mark, recorded.path.parent
    journey = read_journey(recorded)
    what = recorded.name, recorded.settings, recorded.session, journey, _effort(folder)
    with make_progress() as progress:
        if run.scene == REAL_SCENE:
            progress.on_event("saving")
            return save_run(folder, *what)
        from scan3d_twin.run.resolve import load_run_scene
        from scan3d_twin.sim.placed_truth import PlacedTruth
        from scan3d_twin.sim.robot import open_sim

        progress.on_event(f"driving through {mark.stamp:.0f} s again for the truth")
        scene = load_run_scene(run)
        with open_sim(scene, run.seed, recorded.settings.twin) as (robot, truth):
            reenact(robot, read_commands(recorded.path), mark)
            progress.on_event("evaluating and saving")
            places = read_places(recorded.path)
            known = PlacedTruth(truth, scene.spawn, places) if places else truth
            return save_run(folder, *what, known)


def _effort(folder: Path) -> Any:
    """Return what the computer spent on the run, by its last report."""
    from scan3d_twin.recording.overview.listing import REPORT, read_report_or_state
    from scan3d_twin.run.report import Effort

    report, _ = read_report_or_state(folder / REPORT)
    wall, plan, memory = (
        report.get(key, 0.0) for key in ("wall_time_s", "plan_time_s", "peak_memory_mb")
    )
    return Effort(wall, plan, 1e6 * memory)
