"""All files of a finished or broken-off run."""

from __future__ import annotations

from pathlib import Path

from scan3d_twin.core.evaluate import Truth, evaluate
from scan3d_twin.core.model import fuse
from scan3d_twin.core.session import Session
from scan3d_twin.recording.folder import write_file
from scan3d_twin.recording.ply import ply_bytes
from scan3d_twin.recording.report import Effort, Journey, Report, build_report, report_json
from scan3d_twin.recording.settings import Settings
from scan3d_twin.recording.views import view_bytes, view_path
from scan3d_twin.viz.top_view import top_view


def save_run(
    folder: Path,
    scene: str,
    settings: Settings,
    session: Session,
    journey: Journey,
    effort: Effort,
    truth: Truth | None = None,
) -> Report:
    """Write the files of ``session`` to ``folder`` and return the report.

    The views are written once more, because the last alignment may have moved them.
    """
    points, view = fuse(session)
    evaluation = evaluate(session, truth) if truth is not None and len(points) else None
    report = build_report(scene, settings, session, journey, effort, len(points), evaluation)
    for index, each in enumerate(session.views):
        write_file(view_path(folder, index), view_bytes(each))
    picture = top_view(
        points,
        view,
        [each.T_world_scan for each in session.views],
        sweep_width=session.config.sweep.width,
        standoff=session.config.planning.standoff,
        title=_title(report),
    )
    write_file(folder / "model.ply", ply_bytes(points, view))
    write_file(folder / "top_view.svg", picture)
    write_file(folder / "report.json", report_json(report))
    return report


def _title(report: Report) -> str:
    parts = [
        f"{report['views']} views",
        f"\N{GREEK SMALL LETTER EPSILON} = {report['epsilon_mm']:g} mm",
    ]
    if report["coverage_20mm"] is not None:
        parts.append(f"{report['coverage_20mm']:.0%} covered")
    return f"{report['scene']}: {', '.join(parts)}"
