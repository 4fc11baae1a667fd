"""Finds the folders of assets and scenes: beside the package, or in a wheel inside it."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def find_resource_dir(name: str) -> Path:
    """Return the path of the folder ``assets`` or ``scenes``.

    Raises:
        FileNotFoundError: The installation is incomplete.
    """
    for parent in (_PACKAGE / "_data", _PACKAGE.parent):
        if (parent / name).is_dir():
            return parent / name
    raise FileNotFoundError(f"the installation of scan3d_twin lacks its folder {name!r}")
