"""A task: one closed loop of an experiment, before it is run."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from scan3d_twin.bench.record import Record
from scan3d_twin.run.settings import Settings, settings_toml


@dataclass(frozen=True)
class Task:
    """One closed loop to run.

    Attributes:
        scene: Name of the scene in reports.
        variant: Name of the set of options.
        settings: The effective settings, with seed and scene.
        picture: Whether to draw the top view.
    """

    scene: str
    variant: str
    settings: Settings
    picture: bool = False

    @property
    def seed(self) -> int:
        """The run's one seed."""
        return self.settings.run.seed

    @cached_property
    def key(self) -> str:
        """Hash of everything that determines the record; a scene's file by its content."""
        digest = hashlib.sha256(f"{self.variant}\n{settings_toml(self.settings)}".encode())
        if Path(self.settings.run.scene).suffix:
            digest.update(Path(self.settings.run.scene).read_bytes())
        return digest.hexdigest()[:20]

    def with_seed(self, seed: int, *, picture: bool) -> Task:
        """Return the same task with another seed."""
        run = replace(self.settings.run, seed=seed)
        return replace(self, settings=replace(self.settings, run=run), picture=picture)

    def lost_record(self, reason: str, attempts: int) -> Record:
        """Return the record of a task whose worker was lost in the last of ``attempts``."""
        return replace(self.blank_record(), status="lost", stop=reason, attempts=attempts)

    def blank_record(self) -> Record:
        """Return the record of the task before its run: the settings alone."""
        config, run = self.settings.config, self.settings.run
        return Record(
            key=self.key,
            variant=self.variant,
            scene=self.scene,
            seed=run.seed,
            planner=config.planner,
            preset=run.preset,
            world=run.world,
            tour=config.tour,
            scope=config.registration.scope,
            engine=config.registration.engine,
            epsilon=config.planning.epsilon,
            lambda_=config.planning.lambda_,
            gamma=config.planning.gamma,
            sigma=config.planning.sigma,
            standoff=config.planning.standoff,
            trials=config.planning.trials,
            settings=settings_toml(self.settings),
            status="failed",
            stop="",
            version=run.version,
        )
