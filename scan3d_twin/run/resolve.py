"""The effective settings of a run in the twin: defaults < world, scene, preset < what is stated."""

from __future__ import annotations

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.planning import check_planner
from scan3d_twin.run.settings import (
    NAME_OR_PLACE,
    Options,
    Settings,
    device_options,
    settings,
    stated_place,
    world_options,
)
from scan3d_twin.sim.scenes.scene import Scene, load_scene


def resolve_sim(given: Options) -> tuple[Settings, Scene]:
    """Return the effective settings for what is ``given``, and the scene they name.

    Raises:
        ConfigError: A key, name or value is wrong.
        SceneError: The scene cannot be built.
    """
    effective = settings([*_named(given), given])
    check_planner(effective.config.planner, truth_known=True)
    scene = load_scene(effective.run.scene, effective.run.mesh_scale)
    _check_target(effective.run.target, scene)
    return settings_for(scene, given), scene


def settings_for(scene: Scene, given: Options) -> Settings:
    """Return the effective settings in ``scene`` for what is ``given``."""
    return settings([_of_scene(scene), *_named(given), given])


def _check_target(text: str, scene: Scene) -> None:
    """Refuse a target that is neither a place nor one of ``scene``; empty is what stands out."""
    if "," in text:
        stated_place(text, NAME_OR_PLACE)
    elif text and text not in scene.targets:
        raise UnknownNameError("target", text, scene.targets)


def _named(given: Options) -> list[Options]:
    """Return what the devices, the world and the preset stand for."""
    stated = settings([given])
    run, devices = stated.run, stated.twin.devices
    return [device_options(devices), world_options(run.world), preset_options(run.preset)]


def _of_scene(scene: Scene) -> Options:
    """Return what ``scene`` says about how it is to be scanned."""
    standoff = {} if scene.standoff is None else {"standoff": scene.standoff}
    return {"tour": scene.tour, "planning": standoff}
