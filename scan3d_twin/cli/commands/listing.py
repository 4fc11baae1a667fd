"""``twin scenes``, ``planners`` and ``devices``: the choices, one line each."""

from __future__ import annotations

import json as json_module
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.plugins import PluginError

if TYPE_CHECKING:
    from scan3d_twin.sim.scenes.scene import Scene


def scenes(
    *,
    show: str | None = None,
    out: Annotated[Path | None, Parameter(show_default="NAME.png")] = None,
    mesh_scale: float = 1.0,
    mesh_up: str = "auto",
    json: bool = False,
) -> None:
    """List the scenes that come with the package, or draw one.

    Args:
        show: Draw this scene, a name or a file as for `twin sim --scene`, instead of listing.
        out: File for the picture, a PNG.
        mesh_scale: Metres per unit of a mesh file.
        mesh_up: Axis of a mesh file that is up: y, z or auto.
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.sim.scenes.load import load_scene, scene_names

    if show is not None:
        _draw(load_scene(show, mesh_scale, mesh_up=mesh_up), out, json)
        return
    if out is not None:
        raise ConfigError("--out goes with --show NAME")
    loaded = [load_scene(name) for name in scene_names()]
    _show({scene.name: f"[{scene.tour}] {scene.description}" for scene in loaded}, json)


def _draw(scene: Scene, out: Path | None, as_json: bool) -> None:
    """Write the picture of a scene and say where."""
    from scan3d_twin.sim.scenes.pictures import render_scene, write_png

    path = Path(f"{scene.name}.png") if out is None else out
    write_png(path, render_scene(scene))
    print(json_module.dumps({"scene": scene.name, "picture": str(path)}) if as_json else path)


def planners(*, json: bool = False) -> None:
    """List the planners.

    Args:
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.core.planning import list_planners, summarise_planner

    _show({name: _summarise(summarise_planner, name) for name in list_planners()}, json)


def devices(*, json: bool = False) -> None:
    """List the bases, lidars and turntables.

    Args:
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.devices.registry import (
        base_device,
        base_names,
        lidar_device,
        lidar_names,
        turntable_device,
        turntable_names,
    )

    bases = {
        name: f"[base] {_summarise(lambda name: base_device(name).summary, name)}"
        for name in base_names()
    }
    lidars = {
        name: f"[lidar] {_summarise(lambda name: lidar_device(name).summary, name)}"
        for name in lidar_names()
    }
    turntables = {
        name: f"[turntable] {_summarise(lambda name: turntable_device(name).summary, name)}"
        for name in turntable_names()
    }
    _show({**bases, **lidars, **turntables}, json)


def _summarise(summary: Callable[[str], str], name: str) -> str:
    """Return the line about ``name``, or why another package's thing cannot be loaded."""
    try:
        return summary(name)
    except PluginError as error:
        return f"cannot be loaded: {error.reason}"


def _show(lines: dict[str, str], as_json: bool) -> None:
    if as_json:
        print(json_module.dumps(lines, indent=2, ensure_ascii=False))
        return
    width = max(map(len, lines), default=0)
    for name, text in lines.items():
        print(f"{name:<{width}}  {text}".rstrip())
