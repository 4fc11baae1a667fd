"""Scenes prepared for environments: loaded once, with ray caster and surface samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.model.coverable import find_coverable_surface
from scan3d_twin.core.model.sampled_surface import Surface
from scan3d_twin.core.types import BoolArray
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import RayCaster, choose_caster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.random_ranges import SceneRanges
from scan3d_twin.sim.scenes.random_scenes import draw_scene
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.truth import Truth

MAX_CACHED_SCENES = 4
"""Scenes that a process keeps loaded in addition to those in use; some megabytes each."""
SPACING = 0.02
"""Spacing of the surface samples for the coverage [m]: the distance within which a sample counts as
covered; ``evaluate`` uses a quarter of it."""


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A scene, its ray caster, and its target's surface in ``map``.

    Attributes:
        scene: The scene.
        caster: The fastest ray caster for the scene.
        surface: Samples of the target's surface every ``SPACING``.
    """

    scene: Scene
    caster: RayCaster
    surface: Surface

    @staticmethod
    def of(scene: Scene) -> PreparedScene:
        """Return ``scene`` with its ray caster and surface samples."""
        caster = choose_caster(scene.model)
        surface = Surface.of(*_initial_truth(scene, caster).surface(SPACING), SPACING)
        return PreparedScene(scene, caster, surface)


@lru_cache(MAX_CACHED_SCENES)
def prepare_named_scene(name: str) -> PreparedScene:
    """Return the prepared scene called ``name``, as for ``load_scene``."""
    return PreparedScene.of(load_scene(name))


@lru_cache(MAX_CACHED_SCENES)
def prepare_random_scene(seed: int, ranges: SceneRanges) -> PreparedScene:
    """Return the prepared random scene that ``seed`` draws from ``ranges``."""
    return PreparedScene.of(draw_scene(np.random.default_rng(seed), ranges, f"random_{seed}"))


def find_coverable(prepared: PreparedScene, config: Config) -> BoolArray:
    """Return which samples of the surface (n,) can be covered, as ``evaluate`` counts them."""
    return _find_coverable(
        prepared, Config(tour=config.tour, target=config.target, motion=config.motion)
    )


@lru_cache(MAX_CACHED_SCENES)
def _find_coverable(prepared: PreparedScene, config: Config) -> BoolArray:
    truth = _initial_truth(prepared.scene, prepared.caster)
    return find_coverable_surface(prepared.surface.points, prepared.surface.normals, truth, config)


def _initial_truth(scene: Scene, caster: RayCaster) -> Truth:
    """Return the truth of the scene with the robot where it starts."""
    return Truth(scene, KinematicWorld(scene.spawn, scene.model.qpos0), caster, lambda: None)
