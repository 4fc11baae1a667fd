"""The section of a page that shows a model in 3D, over its still picture."""

from __future__ import annotations

import base64
import math
from html import escape
from typing import Any

from scan3d_twin.core.hal import LIDAR_HEIGHT
from scan3d_twin.recording.colours import view_colour
from scan3d_twin.viz import cloud
from scan3d_twin.viz.pages.packing import PackedCloud, Shown, pack
from scan3d_twin.viz.pages.page import embed_json

MISSING, SURFACE = "#d6336c", "#b9c4cf"
"""Colours of the surface that is missing, and of the mesh."""
_MISSING_SWATCH = f'<span class="swatch" style="background:{MISSING}"></span>'
AXIS_LENGTH = 0.25
"""Length of the drawn axes [m]."""


def render_model(shown: Shown, note: str = "") -> str:
    """Return the section with the interactive model over its still picture.

    Args:
        shown: The model, and what is shown beside it.
        note: HTML that stands below it on a screen.
    """
    model = shown.model
    if len(model) == 0:
        return "<h2>Model</h2><p>No view shows anything of the target: there is no model.</p>"

    # Pack points, draw the still picture
    camera = cloud.choose_camera(model.points, [mark.pose for mark in shown.marks])
    packed = pack(shown, camera)
    picture = base64.b64encode(cloud.render_still(model, camera)).decode()
    data, faces = (base64.b64encode(each).decode() for each in (packed.data, packed.faces))

    # Return the section with its data
    return f"""<h2>Model</h2>
<figure>
<div class="frame" id="model">
<img alt="The model in 3D" width="{cloud.STILL_WIDTH}" height="{cloud.STILL_HEIGHT}"
 src="data:image/png;base64,{picture}">
<canvas tabindex="0" role="img"
 aria-label="The model in 3D: drag or press arrows to turn, two fingers or + and - to zoom">
</canvas>
<div class="scale"><span id="length"></span><div id="bar"></div></div>
<div class="legend" id="legend" hidden>
<span id="low"></span><div></div><span id="high"></span></div>
<div class="distance" id="distance" hidden></div>
</div>
{_render_controls(shown)}
<figcaption class="screen">Drag to turn, shift-drag to move, click and scroll or pinch to zoom,
double-click to return. Lines show where each view was taken; the axes at the corner, x red, y green
and z blue, are {AXIS_LENGTH:g} m long. The scale holds in the middle of the model.
{note}</figcaption>
</figure>
<script type="application/json" id="meta">{_meta(shown, packed, camera)}</script>
<script type="text/plain" id="cloud">{data}</script>
<script type="text/plain" id="faces">{faces}</script>"""


def _render_controls(shown: Shown) -> str:
    """Return the controls below the model, hidden until it is drawn."""
    last = len(shown.groups) - 1
    groups = "".join(
        f'<label><input type="checkbox" data-view="{k}" checked>'
        f'<span class="swatch" style="background:{view_colour(k)}"></span>{escape(name)}</label>'
        for k, name in enumerate(shown.groups)
    )
    one = shown.title.lower().removesuffix("s")
    names = [one, "height", *(each.name for each in shown.values)]
    colours = "".join(f'<option value="{escape(each)}">{escape(each)}</option>' for each in names)
    boxes = "".join(
        f'<label><input type="checkbox" id="{name}"{checked}>{swatch}{words}</label>'
        for name, checked, swatch, words, there in (
            ("points", " checked", "", "points", True),
            ("mesh", "", "", "surface", len(shown.mesh.faces)),
            ("around", "", "", "surroundings", len(shown.around)),
            ("missing", "", _MISSING_SWATCH, "not covered", len(shown.missing)),
        )
        if there
    )
    glb = '<button type="button" data-file="glb">GLB</button>\n' if len(shown.mesh.faces) else ""
    return f"""<div class="controls" id="controls">
<label>{shown.title} <input type="range" id="upto" min="0" max="{last}" value="{last}" step="1">
<span id="shown"></span></label>
{groups}
<label>Colour by <select id="colouring">{colours}</select></label>
{boxes}
<label>Section <select id="axis"><option>none</option><option>x</option><option>y</option>
<option>z</option></select></label>
<input type="range" id="cut" min="0" max="1" value="0.5" step="0.01"
 aria-label="Place of the section">
<button type="button" id="measure" aria-pressed="false">Measure</button>
<button type="button" id="reset">Reset view</button>
<span class="files">Save <button type="button" data-file="ply">PLY</button>
<button type="button" data-file="e57">E57</button>
{glb}<button type="button" data-file="json">JSON</button>
<button type="button" data-file="svg">SVG</button></span>
</div>"""


def _meta(shown: Shown, packed: PackedCloud, camera: cloud.Camera) -> str:
    """Return the data of the scripts besides points and surface, as JSON."""
    points, n = shown.model.points, len(shown.groups)
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
        "lines": _viewpoint_lines(shown) + _axes(shown),
        "camera": {
            "middle": [round(float(v), 4) for v in camera.middle],
            "distance": round(camera.distance, 4),
            "azimuth": round(camera.azimuth, 5),
            "elevation": round(camera.elevation, 5),
            "fov": cloud.FIELD_OF_VIEW,
            "aspect": cloud.STILL_WIDTH / cloud.STILL_HEIGHT,
        },
    }
    return embed_json(meta)


def _viewpoint_lines(shown: Shown) -> list[float]:
    """Return the ends of lines that draw a mast and an arrow at each viewpoint.

    Seven numbers an end: x, y, z [m], r, g, b, group.
    """
    numbers: list[float] = []
    for mark in shown.marks:
        # Draw mast and arrow
        k, pose = mark.group, mark.pose
        rgb = [round(int(view_colour(k)[i : i + 2], 16) / 255, 3) for i in (1, 3, 5)]
        half = min(mark.width, math.pi) / 2
        tip = (pose.x, pose.y, LIDAR_HEIGHT)
        ends = [((pose.x, pose.y, 0.0), tip)]
        for turn in (half, -half):
            yaw = pose.yaw + turn
            ends.append(
                (
                    tip,
                    (
                        pose.x + 0.3 * math.cos(yaw),
                        pose.y + 0.3 * math.sin(yaw),
                        LIDAR_HEIGHT,
                    ),
                )
            )
        ends.append((ends[1][1], ends[2][1]))

        # Append ends with colour and group
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
