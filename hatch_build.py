"""Build hook that compiles the registration engine, into the wheel or, in a checkout, in place.

The compiler is ``$CC``, else ``cc``, ``gcc`` or ``clang``; if none works, the package ``ziglang``
with its C compiler is installed for the build alone. It also cross-compiles to the platform in
``$SCAN3D_TWIN_TARGET``, for example ``aarch64-linux-gnu.2.28``: see CONTRIBUTING.md.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "scan3d_twin/core/registration/native"
ZIG = "ziglang==0.17.1"
TARGET = "SCAN3D_TWIN_TARGET"
FLAGS = (
    "-std=gnu11", "-O3", "-fPIC", "-fvisibility=hidden", "-Wall", "-Wextra",
    # The same bits on every processor: no fused operations.
    "-ffp-contract=off",
    # Vectorisation without a change of results.
    "-fno-math-errno", "-fno-trapping-math", "-Wno-psabi",
)  # fmt: skip
LEVELS = {
    "x86_64": {
        "v1": (),
        "v3": ("-march=x86-64-v3",),
        "v4": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    },
    "aarch64": {"v1": ()},
}
"""Flags per processor level, which is the suffix of the exported names; levels.c chooses one at run
time."""


class EngineBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Build hook of hatchling, named in pyproject.toml."""

    def dependencies(self) -> list[str]:
        """Return the packages that the build needs besides hatchling."""
        return [] if _system_compiler() else [ZIG]

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the library and add it to the wheel, or write it beside its sources."""
        folder = Path(self.root) / PACKAGE
        if version == "editable":
            _compile(folder, folder / "libengine.so.1")
            return
        self._built = tempfile.TemporaryDirectory()
        library = Path(self._built.name) / "libengine.so.1"
        _compile(folder, library)
        build_data["force_include"][str(library)] = f"{PACKAGE}/libengine.so.1"
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{_platform_tag()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the temporary library of the wheel."""
        if version != "editable":
            self._built.cleanup()


def _target() -> str:
    return os.environ.get(TARGET, "")


def _architecture() -> str:
    machine = _target().partition("-")[0] or platform.machine()
    return {"arm64": "aarch64", "AMD64": "x86_64"}.get(machine, machine)


def _platform_tag() -> str:
    """Return the platform tag of the wheel: the target's glibc, or that of this machine."""
    if not _target():
        return sysconfig.get_platform().replace("-", "_").replace(".", "_")
    major, _, minor = _target().rpartition("gnu.")[2].partition(".")
    return f"manylinux_{major}_{minor}_{_architecture()}"


def _levels() -> dict[str, tuple[str, ...]]:
    return LEVELS.get(_architecture(), {"v1": ()})


def _system_compiler() -> list[str] | None:
    """Return the command of a compiler that can build all levels, or None."""
    if _target():
        return None
    for name in [os.environ.get("CC", ""), "cc", "gcc", "clang"]:
        command = name.split()
        if command and shutil.which(command[0]) and _builds(command):
            return command
    return None


def _builds(compiler: list[str]) -> bool:
    flags = [flag for level in _levels().values() for flag in level]
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "try.c"
        source.write_text("#include <math.h>\ndouble f(double x) { return sqrt(x); }\n")
        command = [*compiler, *FLAGS, *flags, "-shared", str(source), "-o", f"{folder}/try.so"]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0


def _compile_command() -> list[str]:
    """Return the compiler's command; zig gets a target, as it would use this processor's CPU."""
    system = _system_compiler()
    if system:
        return system
    libc = "gnu.2.28" if platform.libc_ver()[0] == "glibc" else "musl"
    target = _target() or f"{_architecture()}-linux-{libc}"
    return [sys.executable, "-m", "ziglang", "cc", "-target", target]


def _spelled_for(compiler: list[str], flags: tuple[str, ...]) -> list[str]:
    """Return ``flags`` as the compiler spells them: zig 0.17 wants ``x86_64_v3``."""
    zig = "ziglang" in compiler
    return [flag.replace("x86-64-", "x86_64_") if zig else flag for flag in flags]


def _compile(folder: Path, library: Path) -> None:
    """Compile each processor level of the engine and link all into ``library``."""
    sources = sorted([*folder.glob("*.c"), *folder.glob("*.h")])
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    compiler = _compile_command()
    with tempfile.TemporaryDirectory() as scratch:
        commands = {
            f"{scratch}/{level}.o": [
                *_spelled_for(compiler, flags),
                f"-DLEVEL={level}",
                str(folder / "engine.c"),
            ]
            for level, flags in _levels().items()
        }
        commands[f"{scratch}/levels.o"] = [f'-DDIGEST="{digest}"', str(folder / "levels.c")]
        with ThreadPoolExecutor(max_workers=2) as pool:
            jobs = [
                pool.submit(_run, [*compiler, *FLAGS, *arguments, "-c", "-o", made])
                for made, arguments in commands.items()
            ]
        for job in jobs:
            job.result()
        linked = f"{scratch}/libengine.so.1"
        _run([*compiler, "-shared", "-s", "-o", linked, *commands, "-lm"])
        # Replace atomically: running processes keep the library they have loaded.
        shutil.copy(linked, library.with_name("libengine.part"))
        library.with_name("libengine.part").replace(library)


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"error: {' '.join(command[:2])} failed: {done.stderr.strip()[-2000:]}")
