"""An OpenGL context without a screen: by EGL, else by OSMesa, or by what ``MUJOCO_GL`` names."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
from typing import Any, Protocol

from scan3d_twin.core.errors import ConfigError

BACKENDS = ("egl", "osmesa")
INSTALL = (
    "EGL (Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri) or OSMesa (apt install libosmesa6)"
)


class Context(Protocol):
    """An OpenGL context: ``GLContext`` of ``mujoco.egl`` and ``mujoco.osmesa``."""

    def make_current(self) -> None:
        """Make it the context of all OpenGL calls of this thread."""
        ...

    def free(self) -> None:
        """Release the context."""
        ...


def open_context(width: int, height: int) -> Context:
    """Return a context of ``width`` x ``height`` pixels.

    Raises:
        ConfigError: No backend works; the message names what to install.
    """
    # Check packages and wanted backend
    if any(importlib.util.find_spec(name) is None for name in ("OpenGL", "glfw")):
        raise ConfigError("pictures need OpenGL for Python: pip install glfw pyopengl")
    wanted = os.environ.get("MUJOCO_GL")
    if wanted and wanted not in BACKENDS:
        raise ConfigError(f"MUJOCO_GL must be one of {', '.join(BACKENDS)}, got {wanted!r}")

    # Try the backends in turn
    reasons = []
    for backend in (wanted,) if wanted else BACKENDS:
        try:
            context: Context = _open(backend, width, height)
            return context
        except Exception as error:  # noqa: BLE001 - each backend fails in its own way
            reasons.append(f"{backend}: {' '.join(str(error).split()) or type(error).__name__}")
    raise ConfigError(f"nothing here renders pictures; install {INSTALL}; {'; '.join(reasons)}")


def _open(backend: str, width: int, height: int) -> Any:
    """Return a context of ``backend``.

    PyOpenGL keeps the platform of its first import, so its modules are unloaded first.
    """
    for name in [name for name in sys.modules if name.split(".")[0] == "OpenGL"]:
        del sys.modules[name]
    before = os.environ.get("PYOPENGL_PLATFORM")
    os.environ["PYOPENGL_PLATFORM"] = backend
    try:
        return importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
    finally:
        if before is None:
            del os.environ["PYOPENGL_PLATFORM"]
        else:
            os.environ["PYOPENGL_PLATFORM"] = before
