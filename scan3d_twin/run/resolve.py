"""The settings of a run in the twin: scene < devices < world < preset < stated options."""

from __future__ import annotations

from pathlib import Path

from scan3d_twin.core.config import preset_options
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.planning import check_planner
from scan3d_twin.run.settings import (
    NAME_OR_PLACE,
    Options,
    RunConfig,
    Settings,
    build_settings,
    device_options,
    parse_place,
    world_options,
)
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.meshes.files import MESH_SUFFIXES
from scan3d_twin.sim.scenes.scene import Scene


def resolve_sim(given: Options) -> tuple[Settings, Scene]:
    """Return the effective settings for the ``given`` options, and the scene they name.

    Raises:
        ConfigError: A key, name or value is wrong.
        SceneError: The scene cannot be built.
    """
    effective = build_settings([*_named_options(given), given])
    check_planner(effective.config.planner, truth_known=True)
    run = effective.run
    _refuse_mesh_options(run)
    scene = load_run_scene(run)
    _check_target(run.target, scene)
    return settings_for_scene(scene, given), scene


def is_mesh_file(scene: str) -> bool:
    """Return whether ``scene`` is the name of a mesh file."""
    return Path(scene).suffix.lower() in MESH_SUFFIXES


def _refuse_mesh_options(run: RunConfig) -> None:
    """Refuse options of meshes for a scene that is none, where they would do nothing."""
    usual = RunConfig()
    stated = {
        "--mesh-scale": run.mesh_scale != usual.mesh_scale,
        "--mesh-up": run.mesh_up != usual.mesh_up,
        "--room": run.room != usual.room,
    }
    names = ", ".join(name for name, is_stated in stated.items() if is_stated)
    if names and not is_mesh_file(run.scene):
        raise ConfigError(f"{names} changes a mesh file, and the scene {run.scene} is none")


def load_run_scene(run: RunConfig) -> Scene:
    """Return the scene that ``run`` names, with its target where that is a name."""
    return load_scene(
        run.scene,
        run.mesh_scale,
        run.room,
        run.mesh_up,
        target="" if "," in run.target else run.target,
        keyframe=run.keyframe,
    )


def settings_for_scene(scene: Scene, given: Options) -> Settings:
    """Return the effective settings in ``scene`` for the ``given`` options."""
    return build_settings([scene_options(scene), *_named_options(given), given])


def scene_options(scene: Scene) -> Options:
    """Return the options that ``scene`` states about its scanning."""
    standoff = {} if scene.standoff is None else {"standoff": scene.standoff}
    return {"tour": scene.tour, "planning": standoff}


def _check_target(text: str, scene: Scene) -> None:
    """Refuse a target that is neither a place nor a target of ``scene``; empty is accepted."""
    if "," in text:
        parse_place(text, NAME_OR_PLACE)
    elif text and text not in scene.targets:
        raise UnknownNameError("target", text, scene.targets)


def _named_options(given: Options) -> list[Options]:
    """Return the options behind the names of the devices, the world and the preset."""
    stated = build_settings([given])
    run, devices = stated.run, stated.twin.devices
    return [device_options(devices), world_options(run.world), preset_options(run.preset)]
