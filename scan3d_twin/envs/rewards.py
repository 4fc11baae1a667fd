"""The reward of a step: a weighted sum of named terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

from scan3d_twin.core.errors import ConfigError, UnknownNameError


@dataclass(frozen=True, slots=True)
class RewardWeights:
    """Weights of the reward terms; each is >= 0, and costs are subtracted.

    The gain in coverage is the usual reward of next-best-view work (Chen et al., GenNBV, CVPR
    2024). The costs of views, paths and bad registrations are assumptions.
    """

    coverage: float = 1.0
    """Per share of the coverable surface that is newly covered."""
    view: float = 0.02
    """Per view."""
    path: float = 0.05
    """Per metre driven."""
    misplaced: float = 1.0
    """For a view whose registration error exceeds epsilon."""
    failure: float = 1.0
    """For an episode that ends in failure: target lost, view lost, a bump, a cliff."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 <= value < float("inf"):
                raise ConfigError(f"the weight {field.name} must be >= 0, got {value:g}")

    @staticmethod
    def of(weights: Mapping[str, float] | None) -> RewardWeights:
        """Return the weights given by name, with defaults for the rest."""
        known = [field.name for field in fields(RewardWeights)]
        for name in weights or {}:
            if name not in known:
                raise UnknownNameError("reward term", name, known)
        return RewardWeights(**(weights or {}))

    def terms(
        self, gain: float, path: float, *, misplaced: bool, failed: bool, moved: bool = True
    ) -> dict[str, float]:
        """Return the terms of one step; their sum is its reward.

        Args:
            gain: Coverage gained, -1..1.
            path: Length of the path driven [m].
            misplaced: Whether the view's registration error exceeds epsilon.
            failed: Whether the episode ends in failure.
            moved: Whether a view was taken.
        """
        return {
            "coverage": self.coverage * gain,
            "view": -self.view * moved,
            "path": -self.path * path,
            "misplaced": -self.misplaced * misplaced,
            "failure": -self.failure * failed,
        }
