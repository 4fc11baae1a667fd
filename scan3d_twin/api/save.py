"""All files of a finished or interrupted run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scan3d_twin.core.model.evaluation import (
    Comparison,
    Distances,
    Evaluation,
    Reference,
    evaluate_model,
    measure_mesh_accuracy,
)
from scan3d_twin.core.model.fused_cloud import Model, build_view_clouds, join_models
from scan3d_twin.core.model.judged_targets import is_of_target
from scan3d_twin.core.model.mesh import Mesh, build_mesh
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray
from scan3d_twin.recording.ply import model_ply
from scan3d_twin.recording.views import view_bytes, view_path
from scan3d_twin.run.closed_loop import Truth
from scan3d_twin.run.folder import require_own_folders, write_file, write_inside
from scan3d_twin.run.report import Effort, Journey, Report, build_report, count_views, report_json
from scan3d_twin.run.settings import Settings, settings_toml
from scan3d_twin.viz.pages.packing import show_run
from scan3d_twin.viz.pages.report_page import Pictures, render_report_page
from scan3d_twin.viz.top_view import draw_top_view
from scan3d_twin.viz.track import place_track


def save_run(
    folder: Path,
    scene: str,
    settings: Settings,
    session: Session,
    journey: Journey,
    effort: Effort,
    truth: Truth | None = None,
    scene_picture: bytes = b"",
    notes: Sequence[str] = (),
) -> Report:
    """Write the files of ``session`` to ``folder`` and return the report.

    The views are written once more, because the final alignment may have moved them. The model is
    evaluated only if it shows the target of the ground truth. ``scene_picture`` is a PNG of the
    scene; empty for a real robot. The report's warnings begin with ``notes``.
    """
    # Evaluate against the ground truth
    seen = build_view_clouds(session)
    model = join_models([each.cleaned for each in seen])
    mesh = build_mesh(session, seen)
    found = _evaluate(session, model, mesh, truth, settings.run.target)

    # Build the report
    known = () if truth is None else _list_notes(truth, found.reference, settings)
    report = build_report(
        scene,
        settings,
        session,
        journey,
        effort,
        len(model),
        found.evaluation,
        found.mesh_accuracy,
        (*notes, *known),
    )

    # Write views in their final poses, model, pictures and report
    _write_views(folder, session)
    way = place_track(journey.track, session)[:, :2]
    pictures = Pictures(_draw_top_view(session, model, report, way, found), scene_picture)
    write_file(folder / "model.ply", model_ply(model, "metres, frame world"))
    write_file(folder / "top_view.svg", pictures.top_view)
    write_file(folder / "report.json", report_json(report))
    if scene_picture:
        write_file(folder / "scene.png", scene_picture)
    shown = show_run(session, model, mesh, found.compared)
    options = settings_toml(settings)
    page = render_report_page(report, options, session, shown, pictures, found.evaluation)
    write_file(folder / "report.html", page)
    return report


@dataclass(frozen=True)
class _Findings:
    """What the truth says of a run; nothing where it is not known or of another thing."""

    reference: Reference | None = None
    compared: Comparison | None = None
    evaluation: Evaluation | None = None
    mesh_accuracy: Distances | None = None


def _evaluate(
    session: Session, model: Model, mesh: Mesh, truth: Truth | None, target: str
) -> _Findings:
    """Return what the ``truth`` says of ``model`` and ``mesh``, where they show its ``target``."""
    if truth is None or not len(model) or not is_of_target(session, truth, target):
        return _Findings()
    reference = Reference.of(session, truth, target)
    compared = Comparison.of(model, reference)
    evaluation = evaluate_model(session, model, reference, compared)
    return _Findings(reference, compared, evaluation, _mesh_accuracy(session, mesh, reference))


def _write_views(folder: Path, session: Session) -> None:
    """Write the files of the views of ``session``, and remove those of views it has no more."""
    for index, each in enumerate(session.views):
        write_inside(folder, view_path(folder, index), view_bytes(each))
    _remove_views_from(len(session.views), folder)


def _draw_top_view(
    session: Session, model: Model, report: Report, way: FloatArray, found: _Findings
) -> str:
    """Return the top view of ``model`` with the ``way`` (n, 2) [m] of the robot."""
    return draw_top_view(
        model.points,
        model.view,
        [each.T_world_scan for each in session.views],
        sweep_width=session.config.sweep.width,
        standoff=session.config.planning.standoff,
        title=_title(report),
        way=way,
        truth=None if found.compared is None else found.compared.surface,
    )


def _remove_views_from(count: int, folder: Path) -> None:
    """Remove the files of views that the final alignment has dropped."""
    require_own_folders(folder, view_path(folder, count).parent)
    while (path := view_path(folder, count)).exists():
        path.unlink()
        count += 1


def _list_notes(truth: Truth, reference: Reference | None, settings: Settings) -> Iterator[str]:
    """Yield what is known of the scene, and of a model that was not evaluated."""
    yield from truth.notes
    yield from _note_other_thing(truth, reference, settings)


def _note_other_thing(
    truth: Truth, reference: Reference | None, settings: Settings
) -> Iterator[str]:
    """Say that another thing than the target was scanned, where there is no ``reference``."""
    if reference is not None:
        return
    asked, known = settings.run.target, ", ".join(truth.targets)
    what, cure = (
        "a target",
        "something else is in front of it, or more salient; --target chooses by name",
    )
    if asked in truth.targets:
        what = f"the target {asked!r} that was asked for"
        cure = "something else is in front of it; a site 'spawn' says where the robot starts"
    yield (
        f"What was scanned is not {what} of this scene ({known}), so there are no coverage and no "
        f"errors: {cure}."
    )


def _mesh_accuracy(session: Session, mesh: Mesh, reference: Reference) -> Distances | None:
    """Return the distance of the target's mesh to the truth; None if it has no triangles."""
    if len(mesh.faces) == 0:
        return None
    return measure_mesh_accuracy(mesh, reference, np.random.default_rng(session.seed))


def _title(report: Report) -> str:
    parts = [
        count_views(report),
        f"\N{GREEK SMALL LETTER EPSILON} = {report['epsilon_mm']:g} mm",
    ]
    if report["coverage_20mm"] is not None:
        parts.append(f"{report['coverage_20mm']:.0%} covered")
    return f"{report['scene']}: {', '.join(parts)}"
