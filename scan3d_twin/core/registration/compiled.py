"""Which inner loops run compiled: those of ``kernels`` where numba is installed, else none."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
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
    return import_module("scan3d_twin.core.registration.kernels")
