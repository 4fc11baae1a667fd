"""Options of an environment, checked once: scenes, fidelity, settings, reward weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from scan3d_twin.core.config import Config, preset_options
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.devices.registry import lidar_device
from scan3d_twin.envs.prepared_scenes import (
    PreparedScene,
    prepare_named_scene,
    prepare_random_scene,
)
from scan3d_twin.envs.rewards import RewardWeights
from scan3d_twin.envs.scan_sources import EpisodeScanSource, KinematicScanSource, PhysicsScanSource
from scan3d_twin.run.resolve import settings_for_scene
from scan3d_twin.run.settings import Options, build_settings, merge_options
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.kinematic import Thinning, thin_config, thin_spec
from scan3d_twin.sim.scenes.load import scene_names
from scan3d_twin.sim.scenes.random_ranges import SceneRanges
from scan3d_twin.sim.world import Solver

Fidelity = Literal["physics", "lite", "kinematic"]
FIDELITIES: tuple[Fidelity, ...] = ("physics", "lite", "kinematic")
RANDOM = "random"
"""Scene name for a new random scene in every episode."""
RANDOM_NOISE_FACTORS = (0.8, 1.25)
"""Interval of the factor on the lidar's errors in random scenes: an assumption about how sensors
differ."""
THINNING, LITE_SOLVER = Thinning(), Solver(timestep=0.004, impratio=1.0)
"""``lite`` and ``kinematic`` simulate every third beam, of one ray each; ``lite`` has physics steps
of 4 ms and no wheel vibration."""
MAX_POINTS = 600
"""Points of the ICP in ``kinematic``, for speed; the full number is 3000. Loop closure is off there
for the same reason."""


@dataclass(frozen=True)
class EnvOptions:
    """The effective options of an environment.

    Attributes:
        scenes: Scene names, one of which is drawn for each episode; see ``RANDOM``.
        fidelity: How the robot is simulated.
        given: Options as in a configuration file; they override scene, world and preset.
        weights: Weights of the reward terms.
        goal: Coverage at which an episode is a success, 0..1.
        ranges: Ranges of the properties of random scenes.
        noise: Interval of the factor on the lidar's errors.
    """

    scenes: tuple[str, ...]
    fidelity: Fidelity
    given: Options
    weights: RewardWeights
    goal: float
    ranges: SceneRanges
    noise: tuple[float, float]

    @staticmethod
    def of(
        scene: str | Sequence[str],
        fidelity: str,
        preset: str,
        world: str,
        options: Mapping[str, Any] | None,
        rewards: Mapping[str, float] | None,
        goal: float,
        ranges: Mapping[str, Any] | None,
        noise: Sequence[float] | None,
    ) -> EnvOptions:
        """Return the options for the arguments of ``gymnasium.make``.

        Raises:
            ConfigError: A name, key or value is wrong; the message lists the valid ones.
        """
        # Check names and ranges.
        scenes = (scene,) if isinstance(scene, str) else tuple(scene)
        if not scenes:
            raise ConfigError(f"name a scene: {', '.join(scene_names())}, random:SEED or random")
        for name in scenes:
            if name != RANDOM:
                prepare_named_scene(name)
        if fidelity not in FIDELITIES:
            raise UnknownNameError("fidelity", fidelity, FIDELITIES)
        if not 0.0 < goal <= 1.0:
            raise ConfigError(f"goal must be in (0, 1], got {goal:g}")

        # Check the nested options.
        given = merge_options([{"run": {"preset": preset, "world": world}}, options or {}])
        if "run" in (options or {}):
            raise ConfigError(
                "options.run: scene, preset, world and seed are arguments of their own"
            )
        preset_options(preset)
        build_settings([given])

        return EnvOptions(
            scenes=scenes,
            fidelity=fidelity,
            given=given,
            weights=RewardWeights.of(rewards),
            goal=goal,
            ranges=_ranges(ranges),
            noise=_noise(noise, scenes),
        )

    def draw_scene(self, rng: np.random.Generator) -> PreparedScene:
        """Return the scene of an episode."""
        name = self.scenes[int(rng.integers(len(self.scenes)))]
        seed = int(rng.integers(2**31))
        return (
            prepare_random_scene(seed, self.ranges) if name == RANDOM else prepare_named_scene(name)
        )

    def open_source(
        self, prepared: PreparedScene, rng: np.random.Generator
    ) -> tuple[EpisodeScanSource, int]:
        """Return the scan source of an episode, and the seed of its run."""
        effective = settings_for_scene(prepared.scene, self.given)
        factor, seed = float(rng.uniform(*self.noise)), int(rng.integers(2**31))
        twin = _scale_noise(effective.twin, factor)

        # Reduce the fidelity.
        if self.fidelity == "kinematic":
            config = _with_fast_icp(thin_config(effective.config, THINNING))
            return KinematicScanSource(prepared, seed, config, twin, THINNING), seed
        if self.fidelity == "lite":
            spec = thin_spec(lidar_device(twin.lidar_model).spec(twin.lidar_link), THINNING)
            config, twin = thin_config(effective.config, THINNING), _without_vibration(twin)
            return PhysicsScanSource(
                prepared, seed, config, twin, solver=LITE_SOLVER, spec=spec
            ), seed
        return PhysicsScanSource(prepared, seed, effective.config, twin), seed


def _ranges(given: Mapping[str, Any] | None) -> SceneRanges:
    known = SceneRanges.__dataclass_fields__
    for name in given or {}:
        if name not in known:
            raise UnknownNameError("range of random scenes", name, known)
    plain: dict[str, Any] = {
        name: tuple(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
        for name, value in (given or {}).items()
    }
    return SceneRanges(**plain)


def _noise(given: Sequence[float] | None, scenes: tuple[str, ...]) -> tuple[float, float]:
    low, high = given or (RANDOM_NOISE_FACTORS if RANDOM in scenes else (1.0, 1.0))
    if not 0.0 <= low <= high <= 10.0:
        raise ConfigError(f"noise must be (low, high) within 0 and 10, got ({low:g}, {high:g})")
    return float(low), float(high)


def _scale_noise(twin: TwinConfig, factor: float) -> TwinConfig:
    """Return ``twin`` with the lidar's errors scaled by ``factor``."""
    if factor == 1.0:
        return twin
    names = ("sigma", "sigma_per_metre", "sigma_far", "sigma_weak", "pointing", "bias",
             "surface_bias")  # fmt: skip
    scaled = {name: factor * getattr(twin.lidar, name) for name in names}
    return replace(twin, lidar=replace(twin.lidar, **scaled))


def _without_vibration(twin: TwinConfig) -> TwinConfig:
    """Return ``twin`` without wheel vibration, and with lidar beams of one ray."""
    lidar = twin.lidar.for_single_beams()
    return replace(twin, lidar=lidar, errors=replace(twin.errors, cogging=0.0))


def _with_fast_icp(config: Config) -> Config:
    registration = config.registration
    quick = replace(registration, max_points=min(MAX_POINTS, registration.max_points))
    alignment = replace(config.alignment, mode="off")
    return replace(config, registration=quick, alignment=alignment)
