"""Binding of the compiled engine: its structures, its functions, and how the library is found.

``engine.h`` documents the structures; the classes here mirror them field by field. The functions
of ``engine.c`` are attributes of ``engine``: they take contiguous arrays of the right type
(anything else is a ``TypeError``) and release the interpreter lock while they run.

The library holds each function once per processor level and the highest that can run here is used;
all levels give the same result to the last bit. ``hatch_build.py`` builds it into the wheel or, in
a checkout, beside its sources; a library built from other sources is refused.
"""

from __future__ import annotations

import ctypes
import hashlib
from ctypes import c_double, c_int64
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.registration.native.arguments import (
    Bytes,
    Doubles,
    Flags,
    Ints,
    Longs,
    Value,
)

FOLDER = Path(__file__).parent
LIBRARY = FOLDER / "libengine.so.1"
CURE = "run `make setup` in a checkout, or install the package again"
SHADOWED = (
    "Python has found the sources here, not the installed package: run it from another folder"
)

ByteArray = npt.NDArray[np.uint8]

STATE = 8
"""Rows of the matrices of ``Equations``, whatever their size."""
MAX_NEIGHBOURS = 64
"""Most neighbours that a query can return."""


class Sweep(Value):
    """A sweep of lines by beams."""

    _fields_ = (
        ("n_lines", c_int64), ("n_beams", c_int64), ("stride", c_int64), ("ranges", Doubles),
        ("yaws", Doubles), ("rays", Doubles), ("ray_stride", c_int64), ("lever", Doubles),
        ("sigmas", Doubles), ("beam_spacing", c_double),
        ("max_range", c_double),
    )  # fmt: skip


class ScanSurfels(Value):
    """The surfels of a sweep and its noise."""

    _fields_ = (
        ("rows", Doubles), ("yaws", Doubles), ("index", Ints), ("valid", Flags),
        ("noise", c_double * 4), ("line_spacing", c_double), ("count", c_int64),
    )  # fmt: skip


class Projection(Value):
    """Projection of a point onto the reading of a sweep that sees it."""

    _fields_ = (
        ("n_lines", c_int64), ("n_beams", c_int64), ("lines", Ints), ("beams", Ints),
        ("elevations", Doubles), ("search", c_int64), ("yaws", Doubles), ("middles", Doubles),
        ("mount", Doubles), ("backwards", c_int64),
    )  # fmt: skip


class Target(Value):
    """The sweep that others are registered to."""

    _fields_ = (
        ("rows", Doubles), ("yaws", Doubles), ("index", Ints), ("edges", Doubles),
        ("n_edges", c_int64), ("projection", Projection),
    )  # fmt: skip


class Sample(Value):
    """Every ``stride``-th surfel of a sweep along lines and beams."""

    _fields_ = (
        ("count", c_int64), ("stride", c_int64), ("rows", Doubles), ("yaws", Doubles),
        ("chosen", Ints), ("lines", Ints),
    )  # fmt: skip


class Source(Value):
    """The sweep that the iteration moves onto the target."""

    _fields_ = (
        ("coarse", Sample), ("fine", Sample), ("every", Sample), ("edges", Doubles),
        ("n_edges", c_int64), ("first", c_double * 3), ("second", c_double * 9),
    )  # fmt: skip


class PairNoise(Value):
    """Errors of two sweeps beyond the noise of single readings."""

    _fields_ = tuple(
        (name, c_double)
        for name in (
            "jitter", "target_jitter", "density", "share", "tilt",
            "patch", "linearity", "offset", "correlation", "height", "lean", "ahead", "up",
        )
    )  # fmt: skip


class Prior(Value):
    """Prior distribution of the pose and the nuisance parameters."""

    _fields_ = (
        ("mean", c_double * 16), ("covariance", c_double * 36), ("n_entries", c_int64),
        ("entries", c_int64 * 6), ("n_nuisances", c_int64), ("nuisance_information", c_double * 2),
    )  # fmt: skip


class Criteria(Value):
    """Convergence criteria of the iteration, and its first gate."""

    _fields_ = (
        ("max_iterations", c_int64), ("translation_epsilon", c_double),
        ("rotation_epsilon", c_double), ("max_correspondence_distance", c_double),
    )  # fmt: skip


class Gate(Value):
    """Gate for correspondences."""

    _fields_ = (("distance", c_double), ("robust", c_double), ("cosine", c_double))


class Equations(Value):
    """Normal equations, in the first rows and columns of (STATE, STATE) matrices."""

    _fields_ = (
        ("size", c_int64), ("information", c_double * STATE**2), ("lost", c_double * STATE**2),
        ("gradient", c_double * STATE), ("spurious", c_double * STATE**2), ("pairs", c_int64),
        ("square", c_double),
    )  # fmt: skip


class RunResult(Value):
    """Result of the iteration from one start."""

    _fields_ = (
        ("T", c_double * 16), ("nuisances", c_double * 2), ("covariance", c_double * 36),
        ("information", c_double * 36), ("degenerate", c_double * 36), ("n_degenerate", c_int64),
        ("predicted_rmse", c_double), ("square", c_double), ("spread", c_double),
        ("pairs", c_int64), ("surfels", c_int64), ("iterations", c_int64), ("settled", c_int64),
        ("overlap", c_int64),
    )  # fmt: skip


VALUES = (
    Sweep, ScanSurfels, Projection, Target, Sample, Source, PairNoise, Prior, Criteria, Gate,
    Equations, RunResult,
)  # fmt: skip
"""The structures, in the order of ``engine.h``."""

FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "estimate_noise": (c_int64, Sweep, Flags, Doubles),
    "fit_surfels": (c_int64, Sweep, Flags, Flags, Doubles, Longs, c_int64, Doubles, Doubles, Ints),
    "mark_valid": (c_int64, Doubles, Longs, c_int64, Flags),
    "extract_surfels": (c_int64, Sweep, Flags, ScanSurfels),
    "sample_surfels": (None, Ints, c_int64, c_int64, Sample),
    "classify_rays": (c_int64, Ints, Flags, c_int64, c_int64, Bytes),
    "find_edges": (c_int64, Sweep, Doubles, Ints, Flags, c_double, Doubles, c_int64),
    "linearise_edges": (
        None, Doubles, c_int64, Doubles, c_int64, Doubles, c_double, c_double, Doubles, Doubles,
    ),
    "write_cell_centres": (None, Doubles),
    "locate_angles": (None, Doubles, c_int64, Doubles),
    "tabulate_nearest": (c_int64, Doubles, c_int64, c_double, Doubles, Ints),
    "find_readings": (None, Projection, Doubles, c_int64, Flags, Longs),
    "build_equations": (
        c_int64, Target, Sample, Doubles, Doubles, Gate, PairNoise, Prior, Equations,
    ),
    "follow_starts": (
        c_int64, Target, Source, PairNoise, Prior, Criteria, Doubles, c_int64, Doubles, RunResult,
    ),
    "sum_violations": (c_double, Target, Bytes, c_double, Sample, Doubles, Longs),
    "find_contradicted_share": (c_double, Target, Sample, Target, Sample, Doubles),
    "find_determined": (
        c_int64, Doubles, Doubles, Longs, c_int64, c_double, Doubles, Doubles, Doubles,
    ),
    "invert_information": (None, Doubles, c_int64, c_double, Doubles),
    "marginalise": (None, Doubles, c_int64, c_int64, Doubles, Doubles),
    "displace": (None, Doubles, Doubles, c_int64, Doubles),
    "find_deviation": (None, Doubles, Doubles, Doubles),
    "expect_displacement": (c_double, Doubles, Doubles, Doubles),
    "build_tree": (None, Doubles, c_int64, Doubles, Ints, Bytes),
    "find_nearest": (None, Doubles, Ints, Bytes, c_int64, Doubles, c_int64, c_int64, Doubles, Ints),
    "find_closest": (
        None, Doubles, Ints, Bytes, c_int64, Doubles, c_int64, c_double, Doubles, Longs,
    ),
    "fit_neighbourhoods": (None, Doubles, Ints, Bytes, c_int64, c_int64, Doubles, Doubles, Doubles),
    "number_cells": (c_int64, Ints, c_int64, Ints, Ints),
    "find_median": (c_double, Doubles, c_int64),
    "find_cells": (None, Doubles, c_int64, c_double, Ints),
    "sum_moments": (None, Doubles, Doubles, Ints, c_int64, Doubles),
    "add_moments": (None, Doubles, Ints, c_int64, Doubles),
    "fit_patches": (
        c_int64, Doubles, Ints, Bytes, c_int64, Doubles, Doubles, c_int64, c_double, c_double,
        c_double, Doubles, Flags,
    ),
    "pair_patches": (
        c_int64, Doubles, Ints, Bytes, c_int64, Doubles, Doubles, c_int64, Doubles, c_double,
        c_double, Doubles, Ints,
    ),
    "find_near": (c_int64, Doubles, c_int64, Doubles, c_int64, c_double, Flags),
    "mark_mixed_pixels": (
        None, Doubles, Doubles, c_int64, Doubles, c_int64, c_int64, c_double, c_double, Flags,
    ),
    "fill_gaps": (None, Doubles, Doubles, c_int64, Doubles, c_int64, c_int64, c_double, c_double),
    "place_readings": (
        None, Longs, c_int64, c_int64, Doubles, Doubles, Doubles, Doubles, c_int64, Doubles,
        Doubles, Longs, Longs, Doubles,
    ),
    "meet_planes": (
        None, Longs, c_int64, c_int64, Doubles, Doubles, Doubles, c_int64, Doubles, Doubles,
        Doubles, Doubles,
    ),
    "find_near_points": (
        None, Longs, c_int64, c_int64, Doubles, Doubles, Doubles, c_int64, Doubles, Doubles,
        Doubles, Doubles, Flags,
    ),
    "measure_free_reach": (
        c_int64, Longs, Doubles, Bytes, c_int64, c_int64, c_double, c_double, c_double, Doubles,
    ),
    "count_neighbours": (
        None, Doubles, Doubles, Doubles, c_int64, c_int64, c_int64, Longs, Longs, c_int64, c_double,
        c_double, Longs,
    ),
    "dilate": (c_int64, Flags, c_int64, c_int64, Longs, c_int64, Flags),
    "label_components": (c_int64, Flags, c_int64, c_int64, Ints),
    "find_shortest_paths": (
        c_int64, Flags, c_int64, c_int64, c_int64, c_double, c_double, Doubles, Longs,
    ),
    "measure_components": (
        c_int64, Doubles, c_int64, c_int64, Longs, Longs, c_int64, c_double, Longs,
    ),
    "average_windows": (c_int64, Doubles, c_int64, c_int64, c_int64, c_int64, Doubles),
    "mark_floor": (
        c_int64, Longs, c_int64, c_int64, Doubles, c_double, Doubles, Doubles, Doubles, c_int64,
        Doubles, c_int64,
    ),
    "find_hidden": (
        None, Flags, c_int64, c_int64, Doubles, Doubles, c_double, Doubles, Doubles, Longs, c_int64,
        Doubles, Doubles, c_int64, Flags,
    ),
    "write_struct_sizes": (None, Longs),
}  # fmt: skip
"""Return and argument types of the functions of ``engine.c``."""


def digest_sources(folder: Path = FOLDER) -> str | None:
    """Return the digest of the sources in ``folder``; None where there are none, as in a wheel."""
    sources = sorted([*folder.glob("*.c"), *folder.glob("*.h")])
    if not sources:
        return None
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


class Engine:
    """The functions of the library at one processor level, bound when first used.

    Attributes:
        path: The library.
        level: Processor level of its functions; by default the highest that can run here.
    """

    def __init__(self, path: Path = LIBRARY, level: int | None = None) -> None:
        self.path = path
        self._level = level

    @cached_property
    def library(self) -> ctypes.CDLL:
        """The loaded library.

        Raises:
            FileError: It is missing, built for another platform, or older than its sources.
        """
        try:
            library = ctypes.CDLL(str(self.path))
        except OSError as error:
            cure = CURE if self.path.exists() else f"{SHADOWED}, or {CURE}"
            raise FileError(f"cannot load the compiled engine ({error}): {cure}") from None
        wanted, found = digest_sources(), ctypes.c_char_p.in_dll(library, "engine_digest")
        built_from = ctypes.string_at(ctypes.addressof(found)).decode()
        if wanted is not None and built_from != wanted:
            raise FileError(f"the compiled engine was built from other sources: {CURE}")
        return library

    @cached_property
    def level(self) -> int:
        """Processor level of the functions."""
        return self._level or int(self.library.engine_level())

    def __getattr__(self, name: str) -> Any:
        """Return the function ``name``, bound with its argument types."""
        if name not in FUNCTIONS:
            raise AttributeError(f"the engine has no function {name!r}")
        returns, *arguments = FUNCTIONS[name]
        function = getattr(self.library, f"{name}_v{self.level}")
        function.restype = returns
        function.argtypes = [
            ctypes.POINTER(each) if issubclass(each, Value) else each for each in arguments
        ]
        setattr(self, name, function)
        return function


engine = Engine()
"""The engine of this process."""
