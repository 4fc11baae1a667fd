"""Digitising in the twin from Python, with all that ``twin sim`` leaves behind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scan3d_twin.api.run import RunOutcome, raise_if_failed, run_in_folder
from scan3d_twin.api.watch import WatchOptions
from scan3d_twin.core.observer import Observer, Unobserved
from scan3d_twin.core.png import encode_png
from scan3d_twin.core.presets import DEFAULT_PRESET
from scan3d_twin.run.folder import claim_folder, default_folder
from scan3d_twin.run.resolve import resolve_sim
from scan3d_twin.run.settings import absolute_scene, merge_options
from scan3d_twin.sim.config import DEFAULT_WORLD
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.pictures import render_scene
from scan3d_twin.sim.scenes.scene import Scene


def run_sim(
    scene: str = "three_boxes",
    *,
    seed: int = 0,
    preset: str = DEFAULT_PRESET,
    world: str = DEFAULT_WORLD,
    options: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    observer: Observer | None = None,
) -> RunOutcome:
    """Digitise a scene with the twin and save the results, as ``twin sim`` does.

    Args:
        scene: Name of a scene (``scene_names()``), ``random:SEED``, or an .xml or mesh file. A mesh
            stands in a room of 5 by 5 m, or as ``options={"run": {"room": "none"}}`` says.
        seed: The run's one seed; the same seed gives the same files.
        preset: Named options: ``best`` or ``paper``.
        world: Named errors of robot, lidar and floor: ``ideal``, ``typical``, ``harsh`` or
            ``unfiltered``, which is ``typical`` with the lidar noise of older figures.
        options: Nested options as in a configuration file, SI units and radians; they win over
            scene, preset and world: ``{"max_views": 3, "planning": {"epsilon": 0.005}}``.
        out: Folder for the results, new or empty; None makes one under ``runs``.
        observer: Sees every step, and can pause and stop the run.

    Returns:
        The session, its report and the folder of ``model.ply``, ``report.html``, ``session.mcap``.

    Raises:
        ConfigError: A key, name or value is wrong.
        SceneError: The scene cannot be built, or shows no target.
        FileError: The folder cannot be written, or something is in it already.
        ScanError, HazardError: The scan failed; what was scanned by then is saved.

    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result = s3d.run_sim("three_boxes", options={"max_views": 2}, out=folder)
    ...     saved = (result.folder / "model.ply").exists()
    >>> saved, result.report["views"], len(result.session.views)
    (True, 2, 2)
    """
    stated = {
        "run": {"scene": absolute_scene(scene), "seed": seed, "preset": preset, "world": world}
    }
    settings, loaded = resolve_sim(merge_options([options or {}, stated]))
    folder = claim_folder(default_folder(loaded.name) if out is None else Path(out))
    result = run_in_folder(
        settings,
        loaded.name,
        open_sim(loaded, seed, settings.twin),
        folder,
        observer or Unobserved(),
        watch=WatchOptions(picture=lambda: draw_scene(loaded, settings.twin.robot)),
    )
    raise_if_failed(result)
    return result


def draw_scene(scene: Scene, robot: str) -> bytes:
    """Return a picture of ``scene`` as PNG."""
    return encode_png(render_scene(scene, robot))
