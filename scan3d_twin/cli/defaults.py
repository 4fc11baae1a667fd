"""The defaults that help pages show: those of a run for which nothing is stated."""

from __future__ import annotations

from functools import cache

from scan3d_twin.run.settings import Settings

PREFIX = "TWIN_"
"""Prefix of the variables that set options."""


@cache
def default_settings() -> Settings:
    """Return the settings of a run for which nothing is stated."""
    return Settings()


def default_text(template: str) -> str:
    """Return ``template`` with the default settings in place of ``{run.seed}`` and the like.

    Known are the parts of ``Settings`` and ``epsilon_mm`` [mm]. Meant to be called when a help page
    is printed, so that no run waits for it.
    """
    effective = default_settings()
    return template.format(
        run=effective.run,
        config=effective.config,
        twin=effective.twin,
        epsilon_mm=1e3 * effective.config.planning.epsilon,
    )


def format_value(value: object) -> str:
    """Return ``value`` as a person would type it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)
