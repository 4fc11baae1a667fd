"""``report.html``: a run on one self-contained page.

The page fetches nothing; its model turns in any browser with WebGL, others show a still picture.
This module needs only NumPy, so that the robot's own small computer can write the page.
"""

from __future__ import annotations

from dataclasses import dataclass

from scan3d_twin.core.model.evaluation import Evaluation
from scan3d_twin.core.session import Session
from scan3d_twin.run.report import Report, count_views
from scan3d_twin.viz.pages import sections
from scan3d_twin.viz.pages.model_section import render_model
from scan3d_twin.viz.pages.packing import Shown
from scan3d_twin.viz.pages.page import render_page

OTHER_FILES = (
    "For all points, and for LAS, OBJ and other files, run <code>twin export . --to e57</code> in "
    "the folder of this page, or another format."
)
"""Said of the files that a page cannot make: they take the whole cloud, and libraries."""


@dataclass(frozen=True, slots=True)
class Pictures:
    """Pictures of the page besides the model.

    Attributes:
        top_view: The top view as an SVG document.
        scene: A picture of the scene as PNG; empty for a real one.
    """

    top_view: str
    scene: bytes


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
    parts = [
        sections.render_head(report),
        sections.render_warnings(report["warnings"]),
        render_model(shown, OTHER_FILES),
        sections.render_top_view(pictures.top_view, known=evaluation is not None),
        sections.render_views(report, session),
        sections.render_overlap_curves(session),
        sections.render_coverage(session, evaluation, report["sim_time_s"]),
        sections.render_scene(pictures.scene),
        sections.render_options(settings_toml),
        sections.render_foot(report),
    ]
    title = f"{report['scene']}: {count_views(report)}"
    return render_page(title, parts, report, drawn=len(shown.model) > 0)
