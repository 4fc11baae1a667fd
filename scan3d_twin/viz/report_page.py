"""``report.html``: a run on one self-contained page.

The page fetches nothing; its model turns in any browser with WebGL, others show a still picture.
This module needs only NumPy, so that the robot's own small computer can write the page.
"""

from __future__ import annotations

import base64
import json
import math
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

from scan3d_twin.core.model.evaluation import Evaluation
from scan3d_twin.core.model.fused_cloud import Model
from scan3d_twin.core.session import Session
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.run.report import Report
from scan3d_twin.viz import cloud, sections

OFFLINE_POLICY = (
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'\">"
)
"""What the page may load: nothing, whatever the names in it hold."""


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
    model: Model,
    pictures: Pictures,
    evaluation: Evaluation | None = None,
) -> str:
    """Return the page as one HTML document.

    Args:
        report: The content of ``report.json``.
        settings_toml: The effective options.
        session: The run.
        model: The target, as ``build_model`` returns it without voxels.
        pictures: The top view, and the picture of the scene.
        evaluation: Evaluation against the truth; None for a real robot.
    """
    title = f"{report['scene']}: {report['views']} views"
    parts = [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        OFFLINE_POLICY,
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{_read_asset('report.css')}</style></head><body><main>",
        sections.render_head(report),
        sections.render_warnings(report["warnings"]),
        _render_model(session, model),
        sections.render_top_view(pictures.top_view),
        sections.render_views(report, session),
        sections.render_overlap_curves(session),
        sections.render_coverage(session, evaluation),
        sections.render_scene(pictures.scene),
        sections.render_options(settings_toml),
        sections.render_foot(report),
        "</main></body></html>\n",
    ]
    return "\n".join(part for part in parts if part)


def _render_model(session: Session, model: Model) -> str:
    """Return the section with the interactive model over its still picture."""
    if len(model) == 0:
        return "<h2>Model</h2><p>No view shows anything of the target: there is no model.</p>"

    # Pack points, draw the still picture
    viewpoints = [view.T_world_scan for view in session.views]
    camera = cloud.choose_camera(model.points, viewpoints)
    packed = cloud.pack_points(model, len(session.views), cloud.surrounding_points(session), camera)
    picture = base64.b64encode(cloud.render_still(model, camera)).decode()
    data = base64.b64encode(packed.data).decode()

    # Return the section with script
    return f"""<h2>Model</h2>
<figure>
<div class="frame" id="model">
<img alt="The model, coloured by view" width="{cloud.STILL_WIDTH}" height="{cloud.STILL_HEIGHT}"
 src="data:image/png;base64,{picture}">
<canvas tabindex="0" aria-label="The model in 3D: drag to turn, two fingers to zoom"></canvas>
</div>
{_render_controls(session)}
<figcaption class="screen">Drag to turn, shift-drag to move, click and scroll or pinch to zoom,
double-click to return. Every view has its colour; the lines show where it was taken.</figcaption>
</figure>
<script type="application/json" id="meta">{_meta(session, model, packed, camera)}</script>
<script type="text/plain" id="cloud">{data}</script>
<script>{_read_asset("report.js")}</script>"""


def _render_controls(session: Session) -> str:
    """Return the controls below the model, hidden until it is drawn."""
    last = len(session.views) - 1
    views = "".join(
        f'<label><input type="checkbox" data-view="{k}" checked>'
        f'<span class="swatch" style="background:{view_colour(k)}"></span>{k}</label>'
        for k in range(last + 1)
    )
    return f"""<div class="controls" id="controls">
<label>Views <input type="range" id="upto" min="0" max="{last}" value="{last}" step="1">
<span id="shown"></span></label>
{views}
<label><input type="checkbox" id="around">surroundings</label>
<label>Colour <select id="colouring"><option value="view">by view</option>
<option value="height">by height</option></select></label>
<button type="button" id="reset">Reset view</button>
</div>"""


def _meta(session: Session, model: Model, packed: cloud.PackedCloud, camera: cloud.Camera) -> str:
    """Return the data of the script besides the points, as JSON."""
    heights = model.points[:, 2]
    meta: dict[str, Any] = {
        "ranges": packed.ranges,
        "low": [round(float(v), 6) for v in packed.low],
        "extent": round(packed.extent, 6),
        "heights": [round(float(heights.min()), 4), round(float(heights.max()), 4)],
        "colours": [view_colour(k) for k in range(len(session.views))],
        "grey": cloud.GREY,
        "lines": _viewpoint_lines(session),
        "camera": {
            "middle": [round(float(v), 4) for v in camera.middle],
            "distance": round(camera.distance, 4),
            "azimuth": round(camera.azimuth, 5),
            "elevation": round(camera.elevation, 5),
            "fov": cloud.FIELD_OF_VIEW,
            "aspect": cloud.STILL_WIDTH / cloud.STILL_HEIGHT,
        },
    }
    return json.dumps(meta, separators=(",", ":")).replace("</", "<\\/")


def _viewpoint_lines(session: Session) -> list[float]:
    """Return the ends of lines that draw a mast and an arrow at each viewpoint.

    Seven numbers an end: x, y, z [m], r, g, b, view.
    """
    numbers: list[float] = []
    for k, view in enumerate(session.views):
        # Draw mast and arrow
        pose = view.T_world_scan
        rgb = [round(int(view_colour(k)[i : i + 2], 16) / 255, 3) for i in (1, 3, 5)]
        half = min(session.config.sweep.width, math.pi) / 2
        tip = (pose.x, pose.y, cloud.LIDAR_HEIGHT)
        ends = [((pose.x, pose.y, 0.0), tip)]
        for turn in (half, -half):
            yaw = pose.yaw + turn
            ends.append(
                (
                    tip,
                    (
                        pose.x + 0.3 * math.cos(yaw),
                        pose.y + 0.3 * math.sin(yaw),
                        cloud.LIDAR_HEIGHT,
                    ),
                )
            )
        ends.append((ends[1][1], ends[2][1]))

        # Append ends with colour and view
        for pair in ends:
            for place in pair:
                numbers += [*(round(value, 4) for value in place), *rgb, k]
    return numbers


def _read_asset(name: str) -> str:
    return (files("scan3d_twin.viz") / name).read_text(encoding="utf-8")
