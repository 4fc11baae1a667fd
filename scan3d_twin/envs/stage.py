"""Scenes as environments need them: loaded once, with what their evaluation costs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.model.evaluation import Surface, find_coverable_surface
from scan3d_twin.core.types import BoolArray
from scan3d_twin.sim.kinematic import KinematicWorld
from scan3d_twin.sim.ray_casting import RayCaster, choose_caster
from scan3d_twin.sim.scenes.load import load_scene
from scan3d_twin.sim.scenes.random_ranges import SceneRanges
from scan3d_twin.sim.scenes.random_scenes import draw_scene
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.truth import Truth

KEPT = 4
"""Scenes that a process keeps loaded beside those in use; some megabytes each."""
SPACING = 0.02
"""Distance of the surface samples by which environments judge coverage [m], the distance that
counts as covered; ``evaluate`` takes a quarter of it."""


@dataclass(frozen=True, eq=False)
class Stage:
    """A scene, its ray caster, and its target's surface in ``map``.

    Attributes:
        scene: The scene.
        caster: The faster one.
        surface: By samples every ``SPACING``.
    """

    scene: Scene
    caster: RayCaster
    surface: Surface

    @staticmethod
    def of(scene: Scene) -> Stage:
        """Return the stage of ``scene``."""
        caster = choose_caster(scene.model)
        surface = Surface.of(*_truth(scene, caster).surface(SPACING), SPACING)
        return Stage(scene, caster, surface)


@lru_cache(KEPT)
def named_stage(name: str) -> Stage:
    """Return the stage of the scene called ``name``, as for ``load_scene``."""
    return Stage.of(load_scene(name))


@lru_cache(KEPT)
def random_stage(seed: int, ranges: SceneRanges) -> Stage:
    """Return the stage of the scene that ``seed`` draws from ``ranges``."""
    return Stage.of(draw_scene(np.random.default_rng(seed), ranges, f"random_{seed}"))


def coverable(stage: Stage, config: Config) -> BoolArray:
    """Return which samples of the surface (n,) can be covered, as ``evaluate`` counts them."""
    return _coverable(stage, Config(tour=config.tour, target=config.target, motion=config.motion))


@lru_cache(KEPT)
def _coverable(stage: Stage, config: Config) -> BoolArray:
    truth = _truth(stage.scene, stage.caster)
    return find_coverable_surface(stage.surface.points, stage.surface.normals, truth, config)


def _truth(scene: Scene, caster: RayCaster) -> Truth:
    """Return the truth of the scene before anything moved."""
    return Truth(scene, KinematicWorld(scene.spawn), caster, lambda: None)
