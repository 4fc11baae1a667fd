"""Which inner loops run compiled: those of ``kernels`` where numba is installed, else none."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any


def compiled(name: str) -> Callable[..., Any] | None:
    """Return the compiled function ``name``; None without numba (extra ``fast``).

    It has the arguments and the results of the array function of that name.
    """
    module = load_kernels()
    return None if module is None else getattr(module, name)


@cache
def load_kernels() -> ModuleType | None:
    """Return the module of the compiled functions; None without numba."""
    if find_spec("numba") is None:
        return None
    drop_stale(Path(__file__).parent)
    return import_module("scan3d_twin.core.registration.kernels")


def drop_stale(folder: Path) -> None:
    """Remove the indices of numba's cache that are older than any module of ``folder``.

    Numba compares a compiled function with the file it stands in; ours call those of other files.
    """
    newest = max(path.stat().st_mtime for path in folder.glob("*.py"))
    for index in (folder / "__pycache__").glob("*.nbi"):
        with suppress(FileNotFoundError):  # another process may be at it, too
            if index.stat().st_mtime < newest:
                index.unlink()
