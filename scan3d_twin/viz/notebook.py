"""Sessions, models and report pages as Jupyter shows them: HTML that fetches nothing.

A session is plain HTML with pictures, which every viewer of notebooks shows. Models and reports are
pages of their own in a frame, with the scripts that turn them, apart from the notebook's.
"""

from __future__ import annotations

import base64
from html import escape

import numpy as np

from scan3d_twin.core.model.fused_cloud import Model, build_model
from scan3d_twin.core.model.mesh import Mesh
from scan3d_twin.core.session import Session
from scan3d_twin.viz.cloud import choose_camera, render_still
from scan3d_twin.viz.pages.model_section import render_model
from scan3d_twin.viz.pages.packing import Shown
from scan3d_twin.viz.pages.page import render_page
from scan3d_twin.viz.top_view import draw_top_view

MODEL_HEIGHT, REPORT_HEIGHT = 760, 800
"""Heights of the frames of a model and of a report [px]."""
PICTURE_WIDTH = 420
"""Width of a picture of a session, two of which stand side by side [px]."""


def render_html(value: Session | Model) -> str:
    """Return ``value`` as HTML for a notebook."""
    return _render_session(value) if isinstance(value, Session) else _render_model(value)


def frame_page(page: str, height: int, title: str) -> str:
    """Return an HTML document in a frame of ``height`` [px], where its scripts reach nothing else.

    Args:
        page: The document.
        height: Height of the frame [px].
        title: What it shows, for who cannot see it.
    """
    return (
        f'<iframe title="{escape(title)}" sandbox="allow-scripts allow-downloads" width="100%" '
        f'height="{height}" style="border:0" srcdoc="{escape(page)}"></iframe>'
    )


def _render_session(session: Session) -> str:
    """Return the facts of ``session``, its top view and its model as pictures."""
    # State the facts
    model = build_model(session)
    count = f"{len(session.views)} view{'s' if len(session.views) != 1 else ''}"
    facts = (
        f"<p><b>Session of {count}</b>: {escape(session.stop_reason or 'not ended')}.<br>"
        f"Planner {escape(session.config.planner)}, seed {session.seed}, "
        f"\N{GREEK SMALL LETTER EPSILON} = {1e3 * session.config.planning.epsilon:g} mm, "
        f"{len(model):,} points on the target.</p>"
    )
    if len(model) == 0:
        return facts

    # Draw it from above and from where the robot stood
    poses = [view.T_world_scan for view in session.views]
    top = draw_top_view(
        model.points, model.view, poses,
        sweep_width=session.config.sweep.width,
        standoff=session.config.planning.standoff,
        title=count,
    )  # fmt: skip
    still = render_still(model, choose_camera(model.points, poses))
    pictures = _embed(top.encode(), "svg+xml", "Top view") + _embed(still, "png", "The model in 3D")
    return f'{facts}<div style="display:flex;flex-wrap:wrap;gap:16px">{pictures}</div>'


def _embed(picture: bytes, kind: str, words: str) -> str:
    data = base64.b64encode(picture).decode()
    return (
        f'<img alt="{words}" src="data:image/{kind};base64,{data}" '
        f'style="width:{PICTURE_WIDTH}px;max-width:100%;height:auto;object-fit:contain">'
    )


def _render_model(model: Model) -> str:
    """Return ``model`` in 3D."""
    none = np.zeros((0, 3))
    views = int(model.view.max()) + 1 if len(model) else 0
    shown = Shown(
        title="Views",
        groups=tuple(f"{k}" for k in range(views)),
        marks=(),
        model=model,
        values=(),
        around=none,
        missing=none,
        mesh=Mesh(none, np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)),
    )
    title = f"Model of {len(model):,} points"
    page = render_page(title, [render_model(shown)], {"points": len(model)}, drawn=len(model) > 0)
    return frame_page(page, MODEL_HEIGHT, title)
