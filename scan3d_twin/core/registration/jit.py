"""How loops are compiled: numba (extra ``fast``), cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit
from numba.extending import overload

OPTIONS = {"fastmath": {"contract", "reassoc", "nsz", "arcp"}, "error_model": "numpy"}

jit = njit(cache=True, **OPTIONS)
inlined = njit(cache=True, forceinline=True, **OPTIONS)
"""For functions that loops in wide registers call: LLVM leaves long ones out of line."""


def as_written(function: Callable[..., Any]) -> None:
    """Let compiled code call a function of plain Python; it is compiled as it stands."""
    overload(function, jit_options=OPTIONS, strict=False)(lambda *_: function)


def twin_of(arrays: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function; compiled code runs it wherever it calls ``arrays``."""

    def compile_(loops: Callable[..., Any]) -> Any:
        overload(arrays, jit_options=OPTIONS, strict=False)(lambda *arguments: loops)
        return jit(loops)

    return compile_
