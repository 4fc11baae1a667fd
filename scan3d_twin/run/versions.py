"""The versions that a bug report must name, found without importing the libraries."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from scan3d_twin import __version__

LIBRARIES = (
    "numpy", "scipy", "mujoco-core", "embreex", "trimesh", "mcap", "rosbags", "viser",
    "cyclopts",
)  # fmt: skip
"""Distributions whose versions can change a result, a file or the command line."""


def collect_versions() -> dict[str, str]:
    """Return versions by name: the program, Python, installed libraries and the system."""
    found = {"scan3d_twin": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return {**found, "platform": platform.platform()}


def format_versions() -> str:
    """Return what ``twin --version`` prints."""
    found = collect_versions()
    width = max(map(len, found))
    return "\n".join(f"{name:<{width}}  {text}" for name, text in found.items())
