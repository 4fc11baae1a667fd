"""The controls of what a page shows, and how: layers, colours, camera, screenshot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from scan3d_twin.core.errors import TwinError
from scan3d_twin.core.png import encode_png
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray
from scan3d_twin.viz.served.point_colours import COLOURINGS
from scan3d_twin.viz.served.stage import Stage

SCREENSHOT_PATIENCE = 60.0
"""Longest time in which a browser draws a screenshot [s]: without a graphics card it takes 10 s."""


def add_look_controls(
    gui: Any,
    stage: Stage,
    session: Callable[[], Session | None],
    truth: Callable[[], FloatArray | None] | None = None,
) -> None:
    """Add to ``gui`` the controls of the appearance of ``stage``.

    Args:
        gui: The panel.
        stage: What is shown.
        session: Returns the session that is shown; None before the first view.
        truth: Returns the triangles (m, 3, 3) of the true surface in ``world`` [m], asked when they
            are wanted first, or None before the first view; None where there is no truth.
    """
    # What is shown
    background = gui.add_checkbox("Background", initial_value=True)
    background.on_update(lambda _: stage.show_background(background.value))
    dark = gui.add_checkbox("Dark", initial_value=False)
    dark.on_update(lambda _: stage.set_dark(dark.value))
    path = gui.add_checkbox("Driven path", initial_value=True)
    path.on_update(lambda _: stage.set_path_shown(path.value))
    if truth is not None:
        _add_truth_control(gui, stage, truth)
    colouring = gui.add_dropdown("Colour by", COLOURINGS, initial_value=COLOURINGS[0])
    colouring.on_update(lambda _: stage.set_colouring(colouring.value))

    # Camera and screenshot
    fit = gui.add_button("Fit to target", icon=viser.Icon.FOCUS_CENTERED)
    fit.on_click(lambda event: _fit(stage, session(), event.client))
    shot = gui.add_button("Screenshot", icon=viser.Icon.CAMERA)
    shot.on_click(lambda event: _save_screenshot(event.client))


def _add_truth_control(gui: Any, stage: Stage, truth: Callable[[], FloatArray | None]) -> None:
    """Add the control of the true surface, which is made when it is wanted first."""
    box = gui.add_checkbox(
        "True surface", initial_value=False, hint="The twin's scene, laid on the model"
    )
    made: list[bool] = []

    def refuse(event: Any, reason: str) -> None:
        box.value = False
        if event.client is not None:
            event.client.add_notification("No true surface", reason)

    def show(event: Any) -> None:
        if box.value and not made:
            try:
                triangles = truth()
            except TwinError as error:
                box.disabled = True
                return refuse(event, str(error))
            if triangles is None:
                return refuse(event, "it is laid on the first view: wait until that is finished")
            stage.show_truth(triangles)
            made.append(True)
        stage.set_truth_shown(box.value)

    box.on_update(show)


def _fit(stage: Stage, session: Session | None, client: viser.ClientHandle | None) -> None:
    """Point the camera of the page that asked at the target."""
    if session is not None and session.views:
        stage.aim_camera(session, client)


def _save_screenshot(client: viser.ClientHandle | None) -> None:
    """Let the page that asked save what it shows, as a PNG file."""
    if client is None:
        return
    height, width = client.camera.image_height, client.camera.image_width
    try:
        picture = client.get_render(
            height, width, transport_format="png", timeout=SCREENSHOT_PATIENCE
        )
    except TimeoutError:
        client.add_notification("No screenshot", "the browser took too long to draw it")
        return
    client.send_file_download("scan3d_twin.png", encode_png(picture), save_immediately=True)
