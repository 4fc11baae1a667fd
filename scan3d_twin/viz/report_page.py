"""``report.html``: a run on one self-contained page.

The page fetches nothing; its model turns in any browser with WebGL, others show a still picture.
This module needs only NumPy, so that the robot's own small computer can write the page.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from importlib.resources import files

from scan3d_twin.core.model.evaluation import Evaluation
from scan3d_twin.core.session import Session
from scan3d_twin.run.report import Report, report_json
from scan3d_twin.viz import sections
from scan3d_twin.viz.model_section import render_model
from scan3d_twin.viz.packing import Shown

SCRIPTS = ("report_drawing.js", "report_files.js", "report.js")


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures of the page besides the model.

    Attributes:
        top_view: The top view as an SVG document.
        scene: A picture of the scene as PNG, or a sentence why there is none.
    """

    top_view: str
    scene: bytes | str


def render_report_page(
    report: Report,
    settings_toml: str,
    session: Session,
    shown: Shown,
    pictures: Pictures,
    evaluation: Evaluation | None = None,
) -> str:
    """Return the page as one HTML document.

    Args:
        report: The content of ``report.json``.
        settings_toml: The effective options.
        session: The run.
        shown: The model and what is shown beside it.
        pictures: The top view, and the picture of the scene.
        evaluation: Evaluation against the truth; None for a real robot.
    """
    title = f"{report['scene']}: {report['views']} views"
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{_read_asset('report.css')}</style></head><body><main>",
        sections.render_head(report),
        sections.render_warnings(report["warnings"]),
        render_model(session, shown),
        _render_report(report),
        sections.render_top_view(pictures.top_view, known=evaluation is not None),
        sections.render_views(report, session),
        sections.render_overlap_curves(session),
        sections.render_coverage(session, evaluation, report["sim_time_s"]),
        sections.render_scene(pictures.scene),
        sections.render_options(settings_toml),
        sections.render_foot(report),
        *_render_scripts(shown),
        "</main></body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def _render_report(report: Report) -> str:
    """Return the report as data of the page, which gives it back as a file."""
    text = report_json(report).replace("<", "\\u003c")
    return f'<script type="application/json" id="report">{text}</script>'


def _render_scripts(shown: Shown) -> list[str]:
    """Return the scripts of the model, at the end: they read what the page holds."""
    names = SCRIPTS if len(shown.model) else ()
    return [f"<script>{_read_asset(name)}</script>" for name in names]


def _read_asset(name: str) -> str:
    return (files("scan3d_twin.viz") / name).read_text(encoding="utf-8")
