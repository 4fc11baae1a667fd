"""``twin scenes`` and ``twin planners``: what there is to choose from, a line each."""

from __future__ import annotations

import json as json_module


def scenes(*, json: bool = False) -> None:
    """List the scenes that come with the package.

    Args:
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.sim.scene import load_scene, scene_names

    loaded = [load_scene(name) for name in scene_names()]
    _show({scene.name: f"[{scene.tour}] {scene.description}" for scene in loaded}, json)


def planners(*, json: bool = False) -> None:
    """List the planners.

    Args:
        json: Print one JSON document instead of lines.
    """
    from scan3d_twin.core.planning import make_planner, planner_names

    names = planner_names()
    _show({name: (type(make_planner(name)).__doc__ or "").split("\n")[0] for name in names}, json)


def _show(lines: dict[str, str], as_json: bool) -> None:
    if as_json:
        print(json_module.dumps(lines, indent=2, ensure_ascii=False))
        return
    width = max(map(len, lines), default=0)
    for name, text in lines.items():
        print(f"{name:<{width}}  {text}".rstrip())
