"""The section of ``report.html`` that shows the model in 3D, over its still picture."""

from __future__ import annotations

import base64
import json
import math
from html import escape
from typing import Any

from scan3d_twin.core.session import Session
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.viz import cloud
from scan3d_twin.viz.packing import PackedCloud, Shown, pack

MISSING, SURFACE = "#d6336c", "#b9c4cf"
"""Colours of the surface that is missing, and of the mesh."""
AXIS_LENGTH = 0.25
"""Length of the drawn axes [m]."""


def render_model(session: Session, shown: Shown) -> str:
    """Return the section with the interactive model over its still picture."""
    model = shown.model
    if len(model) == 0:
        return "<h2>Model</h2><p>No view shows anything of the target: there is no model.</p>"

    # Pack points, draw the still picture
    viewpoints = [view.T_world_scan for view in session.views]
    camera = cloud.choose_camera(model.points, viewpoints)
    packed = pack(shown, len(session.views), camera)
    picture = base64.b64encode(cloud.render_still(model, camera)).decode()
    data, faces = (base64.b64encode(each).decode() for each in (packed.data, packed.faces))

    # Return the section with its data
    return f"""<h2>Model</h2>
<figure>
<div class="frame" id="model">
<img alt="The model, coloured by view" width="{cloud.STILL_WIDTH}" height="{cloud.STILL_HEIGHT}"
 src="data:image/png;base64,{picture}">
<canvas tabindex="0" role="img"
 aria-label="The model in 3D: drag or press arrows to turn, two fingers or + and - to zoom">
</canvas>
<div class="scale"><span id="length"></span><div id="bar"></div></div>
<div class="legend" id="legend" hidden>
<span id="low"></span><div></div><span id="high"></span></div>
<div class="distance" id="distance" hidden></div>
</div>
{_render_controls(session, shown)}
<figcaption class="screen">Drag to turn, shift-drag to move, click and scroll or pinch to zoom,
double-click to return. Lines show where each view was taken; the axes at the corner, x red, y green
and z blue, are {AXIS_LENGTH:g} m long. The scale holds in the middle of the model.</figcaption>
</figure>
<script type="application/json" id="meta">{_meta(session, shown, packed, camera)}</script>
<script type="text/plain" id="cloud">{data}</script>
<script type="text/plain" id="faces">{faces}</script>"""


def _render_controls(session: Session, shown: Shown) -> str:
    """Return the controls below the model, hidden until it is drawn."""
    last = len(session.views) - 1
    views = "".join(
        f'<label><input type="checkbox" data-view="{k}" checked>'
        f'<span class="swatch" style="background:{view_colour(k)}"></span>{k}</label>'
        for k in range(last + 1)
    )
    names = ["view", "height", *(each.name for each in shown.values)]
    colours = "".join(f'<option value="{escape(each)}">{escape(each)}</option>' for each in names)
    missing = (
        '<label><input type="checkbox" id="missing">'
        f'<span class="swatch" style="background:{MISSING}"></span>not covered</label>'
        if len(shown.missing)
        else ""
    )
    return f"""<div class="controls" id="controls">
<label>Views <input type="range" id="upto" min="0" max="{last}" value="{last}" step="1">
<span id="shown"></span></label>
{views}
<label>Colour by <select id="colouring">{colours}</select></label>
<label><input type="checkbox" id="points" checked>points</label>
<label><input type="checkbox" id="mesh">surface</label>
<label><input type="checkbox" id="around">surroundings</label>
{missing}
<label>Section <select id="axis"><option>none</option><option>x</option><option>y</option>
<option>z</option></select></label>
<input type="range" id="cut" min="0" max="1" value="0.5" step="0.01"
 aria-label="Place of the section">
<button type="button" id="measure" aria-pressed="false">Measure</button>
<button type="button" id="reset">Reset view</button>
<span class="files">Save <button type="button" data-file="ply">PLY</button>
<button type="button" data-file="glb">GLB</button>
<button type="button" data-file="json">JSON</button>
<button type="button" data-file="svg">SVG</button></span>
</div>"""


def _meta(session: Session, shown: Shown, packed: PackedCloud, camera: cloud.Camera) -> str:
    """Return the data of the scripts besides points and surface, as JSON."""
    points, n = shown.model.points, len(session.views)
    around, missing, mesh = packed.ranges[n:]
    corners = points.min(axis=0), points.max(axis=0)
    meta: dict[str, Any] = {
        "ranges": {"views": packed.ranges[:n], "around": around, "missing": missing, "mesh": mesh},
        "low": [round(float(v), 6) for v in packed.low],
        "extent": round(packed.extent, 6),
        "heights": [round(float(each[2]), 4) for each in corners],
        "box": [[round(float(v), 4) for v in each] for each in corners],
        "values": [
            {"name": each.name, "unit": each.unit, "low": each.low, "high": each.high}
            for each in shown.values
        ],
        "colours": [view_colour(k) for k in range(n)],
        "grey": cloud.GREY,
        "missing": MISSING,
        "surface": SURFACE,
        "lines": _viewpoint_lines(session) + _axes(shown),
        "camera": {
            "middle": [round(float(v), 4) for v in camera.middle],
            "distance": round(camera.distance, 4),
            "azimuth": round(camera.azimuth, 5),
            "elevation": round(camera.elevation, 5),
            "fov": cloud.FIELD_OF_VIEW,
            "aspect": cloud.STILL_WIDTH / cloud.STILL_HEIGHT,
        },
    }
    return json.dumps(meta, separators=(",", ":")).replace("<", "\\u003c")


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


def _axes(shown: Shown) -> list[float]:
    """Return the axes of ``world`` at the lower corner of the model, as ends of lines as above."""
    corner, numbers = shown.model.points.min(axis=0), list[float]()
    for axis in range(3):
        tip = corner.copy()
        tip[axis] += AXIS_LENGTH
        colour = [0.9 if axis == i else 0.15 for i in range(3)]
        for end in (corner, tip):
            numbers += [*(round(float(v), 4) for v in end), *colour, 0]
    return numbers
