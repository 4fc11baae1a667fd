"""The effective settings of a run in the twin: defaults < world, scene, preset < what is stated."""

from __future__ import annotations

from scan3d_twin.core.planning import check_planner
from scan3d_twin.core.presets import preset
from scan3d_twin.recording.settings import Options, Settings, settings, world_options
from scan3d_twin.sim.scene import Scene, load_scene


def resolve_sim(given: Options) -> tuple[Settings, Scene]:
    """Return the effective settings for what is ``given``, and the scene they name.

    Raises:
        ConfigError: A key, name or value is wrong.
        SceneError: The scene cannot be built.
    """
    run = settings([given]).run
    named = [world_options(run.world), preset(run.preset)]
    effective = settings([*named, given])
    check_planner(effective.config.planner, truth_known=True)
    scene = load_scene(effective.run.scene, effective.run.mesh_scale)
    return settings([_of_scene(scene), *named, given]), scene


def _of_scene(scene: Scene) -> Options:
    """Return what ``scene`` says about how it is to be scanned."""
    standoff = {} if scene.standoff is None else {"standoff": scene.standoff}
    return {"tour": scene.tour, "planning": standoff}
