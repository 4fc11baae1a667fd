"""Configurations of the preset ``paper`` with changes, for tests of the paper's own algorithms."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from scan3d_twin.core.config import AlignmentConfig, Config, RegistrationConfig, SweepConfig
from scan3d_twin.core.planning_config import PlanningConfig

PAPER = Config.preset("paper")


def paper_config(**changes: Any) -> Config:
    """Return the preset ``paper`` with other ``changes`` of its fields."""
    return replace(PAPER, **changes)


def paper_sweep(**changes: Any) -> SweepConfig:
    """Return its sweeps with ``changes``."""
    return replace(PAPER.sweep, **changes)


def paper_registration(**changes: Any) -> RegistrationConfig:
    """Return its registration with ``changes``."""
    return replace(PAPER.registration, **changes)


def paper_alignment(**changes: Any) -> AlignmentConfig:
    """Return its alignment with ``changes``."""
    return replace(PAPER.alignment, **changes)


def paper_planning(**changes: Any) -> PlanningConfig:
    """Return its planning with ``changes``."""
    return replace(PAPER.planning, **changes)
