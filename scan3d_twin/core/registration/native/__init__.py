"""The compiled engine, and its border: what crosses it and how it is checked.

``engine.h`` says what the values mean; the classes here mirror them field by field. The functions
of ``engine.c`` are attributes of ``engine``: they take contiguous arrays of the right type
(anything else is an error at the border) and give up the interpreter lock while they run.

The library holds its functions once for each level of the processor; the highest that this one can
run is taken. All levels give the same bits. It is built by ``hatch_build.py``, into the wheel or,
in a checkout, beside its sources; there it is refused when it was built from others.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Callable
from ctypes import c_double, c_int64
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from scan3d_twin.core.errors import FileError

FOLDER = Path(__file__).parent
LIBRARY = FOLDER / "libengine.so.1"
CURE = "run `make setup` in a checkout, or install the package again"

ByteArray = npt.NDArray[np.uint8]

STATE = 8
"""Rows of the matrices of ``Equations``, whatever their size."""
MOST_NEIGHBOURS = 64
"""Nearest neighbours that can be asked for."""


HEAD = object.__basicsize__
"""Bytes of an array object before the address of its numbers: that is the first field of NumPy's
``PyArrayObject``. ``array.ctypes.data`` is the same, but describes the whole array first, which
takes longer than some of the functions here."""


def address_of(array: npt.NDArray[Any]) -> int:
    """Return where the numbers of ``array`` are."""
    return ctypes.c_size_t.from_address(id(array) + HEAD).value


class Array(ctypes.c_void_p):
    """Address of a contiguous array of ``dtype``; None is no array."""

    dtype: ClassVar[np.dtype[Any]]

    @classmethod
    def from_param(cls, array: npt.NDArray[Any] | None) -> Array:
        """Return the address of ``array``.

        Raises:
            TypeError: The array is of another type or not contiguous.
        """
        if array is None:
            return cls(None)
        if array.dtype != cls.dtype or not array.flags.c_contiguous:
            raise TypeError(f"{cls.__name__} takes contiguous arrays of {cls.dtype}")
        return cls(address_of(array))


class Doubles(Array):
    """Of float64."""

    dtype = np.dtype(np.float64)


class Ints(Array):
    """Of int32."""

    dtype = np.dtype(np.int32)


class Longs(Array):
    """Of int64."""

    dtype = np.dtype(np.int64)


class Flags(Array):
    """Of bool."""

    dtype = np.dtype(np.bool_)


class Bytes(Array):
    """Of uint8."""

    dtype = np.dtype(np.uint8)


class Value(ctypes.Structure):
    """A value of ``engine.h``; it keeps the arrays alive that it points to."""

    converters: ClassVar[dict[str, Callable[[Any], Any]]]

    def __init_subclass__(cls) -> None:
        cls.converters = {
            name: kind.from_param if issubclass(kind, Array) else partial(_filled, kind)
            for name, kind, *_ in cls._fields_
            if issubclass(kind, (Array, ctypes.Array))
        }

    def __init__(self, **fields: Any) -> None:
        """Set ``fields``: arrays by their address, numbers of a field of several one by one."""
        super().__init__()
        self.alive = fields
        for name, value in fields.items():
            convert = self.converters.get(name)
            setattr(self, name, convert(value) if convert else value)

    def numbers(self, name: str, *shape: int) -> npt.NDArray[np.float64]:
        """Return a copy of the first numbers of a field, in ``shape``."""
        first = int(getattr(type(self), name).offset)
        return np.frombuffer(bytes(self), np.float64, math.prod(shape), first).reshape(shape).copy()


def _filled(kind: Any, numbers: Any) -> Any:
    """Return a field of several numbers; those that are not given are 0."""
    if isinstance(numbers, np.ndarray):
        return kind.from_buffer_copy(np.ascontiguousarray(numbers, kind._type_))
    return kind(*numbers)


class Sweep(Value):
    """A sweep: lines by beams."""

    _fields_ = (
        ("n_lines", c_int64), ("n_beams", c_int64), ("stride", c_int64), ("ranges", Doubles),
        ("yaws", Doubles), ("rays", Doubles), ("ray_stride", c_int64), ("lever", Doubles),
        ("sigmas", Doubles), ("beam_spacing", c_double),
    )  # fmt: skip


class Survey(Value):
    """What a sweep shows."""

    _fields_ = (
        ("rows", Doubles), ("yaws", Doubles), ("index", Ints), ("valid", Flags),
        ("noise", c_double * 3), ("line_spacing", c_double), ("count", c_int64),
    )  # fmt: skip


class Projection(Value):
    """From a point to the reading of a sweep that sees it."""

    _fields_ = (
        ("n_lines", c_int64), ("n_beams", c_int64), ("lines", Ints), ("beams", Ints),
        ("beam_stride", c_int64), ("yaws", Doubles), ("middles", Doubles), ("mount", Doubles),
        ("backwards", c_int64),
    )  # fmt: skip


class Target(Value):
    """What other sweeps are laid on."""

    _fields_ = (
        ("rows", Doubles), ("yaws", Doubles), ("index", Ints), ("edges", Doubles),
        ("n_edges", c_int64), ("projection", Projection),
    )  # fmt: skip


class Sample(Value):
    """Surfels of a sweep, every ``stride``-th along lines and beams."""

    _fields_ = (
        ("count", c_int64), ("stride", c_int64), ("room", c_int64), ("columns", Doubles),
        ("yaws", Doubles), ("lines", Ints),
    )  # fmt: skip


class Source(Value):
    """What the iteration lays on the target."""

    _fields_ = (
        ("coarse", Sample), ("fine", Sample), ("every", Sample), ("edges", Doubles),
        ("n_edges", c_int64), ("first", c_double * 3), ("second", c_double * 9),
    )  # fmt: skip


class PairNoise(Value):
    """What two sweeps err by beside the noise of single readings."""

    _fields_ = tuple(
        (name, c_double) for name in ("jitter", "target_jitter", "density", "share", "tilt")
    )


class Prior(Value):
    """What is known beforehand."""

    _fields_ = (
        ("mean", c_double * 16), ("covariance", c_double * 36), ("n_entries", c_int64),
        ("entries", c_int64 * 6), ("n_nuisances", c_int64), ("nuisance_information", c_double * 2),
    )  # fmt: skip


class Criteria(Value):
    """When the iteration ends, and the widest gate."""

    _fields_ = (
        ("max_iterations", c_int64), ("translation_epsilon", c_double),
        ("rotation_epsilon", c_double), ("max_correspondence_distance", c_double),
    )  # fmt: skip


class Gate(Value):
    """Which pairs count."""

    _fields_ = (("distance", c_double), ("robust", c_double))


class Equations(Value):
    """Normal equations, in the first rows and columns of (STATE, STATE)."""

    _fields_ = (
        ("size", c_int64), ("information", c_double * STATE**2), ("lost", c_double * STATE**2),
        ("gradient", c_double * STATE), ("spurious", c_double * STATE**2), ("pairs", c_int64),
        ("square", c_double),
    )  # fmt: skip


class RunResult(Value):
    """Where the iteration from one start ended."""

    _fields_ = (
        ("T", c_double * 16), ("nuisances", c_double * 2), ("covariance", c_double * 36),
        ("information", c_double * 36), ("degenerate", c_double * 36), ("n_degenerate", c_int64),
        ("predicted_rmse", c_double), ("square", c_double), ("pairs", c_int64),
        ("surfels", c_int64), ("iterations", c_int64), ("settled", c_int64), ("overlap", c_int64),
    )  # fmt: skip


VALUES = (
    Sweep, Survey, Projection, Target, Sample, Source, PairNoise, Prior, Criteria, Gate, Equations,
    RunResult,
)  # fmt: skip
"""In the order of ``engine.h``."""

FUNCTIONS: dict[str, tuple[Any, ...]] = {
    "range_noise": (None, Sweep, Flags, Doubles),
    "line_residuals": (None, Sweep, Doubles, Ints, Doubles),
    "yaw_jitter": (c_double, Doubles, c_int64),
    "surfels": (c_int64, Sweep, Flags, Flags, Doubles, Longs, c_int64, Doubles, Doubles, Ints),
    "survey": (c_int64, Sweep, Longs, Flags, Survey),
    "sample": (None, Ints, c_int64, c_int64, Doubles, Doubles, Sample),
    "known": (c_int64, Ints, Flags, c_int64, c_int64, Bytes),
    "edges": (c_int64, Sweep, Doubles, Ints, Flags, c_double, Doubles, c_int64),
    "edge_equations": (
        None, Doubles, c_int64, Doubles, c_int64, Doubles, c_double, c_double, Doubles, Doubles,
    ),
    "cell_centres": (None, Doubles),
    "table": (c_int64, Doubles, c_int64, c_double, Doubles, Ints),
    "lookup": (None, Projection, Doubles, c_int64, Flags, Longs),
    "equations": (c_int64, Target, Sample, Doubles, Doubles, Gate, PairNoise, Prior, Equations),
    "follow": (
        c_int64, Target, Source, PairNoise, Prior, Criteria, Doubles, c_int64, Doubles, RunResult,
    ),
    "violations": (c_double, Target, Bytes, Sample, Doubles, Longs),
    "determined": (
        c_int64, Doubles, Doubles, Longs, c_int64, c_double, Doubles, Doubles, Doubles,
    ),
    "inverse": (None, Doubles, c_int64, c_double, Doubles),
    "marginal": (None, Doubles, c_int64, c_int64, Doubles, Doubles),
    "displaced": (None, Doubles, Doubles, c_int64, Doubles),
    "deviation": (None, Doubles, Doubles, Doubles),
    "displacement": (c_double, Doubles, Doubles, Doubles),
    "tree": (None, Doubles, c_int64, Doubles, Ints, Bytes),
    "nearest": (None, Doubles, Ints, Bytes, c_int64, Doubles, c_int64, c_int64, Doubles, Ints),
    "neighbourhoods": (None, Doubles, Ints, Bytes, c_int64, c_int64, Doubles, Doubles, Doubles),
    "near": (c_int64, Doubles, c_int64, Doubles, c_int64, c_double, Flags),
    "mixed": (None, Doubles, Doubles, Doubles, c_int64, c_int64, c_double, c_double, Flags),
    "gaps": (None, Doubles, Doubles, Doubles, c_int64, c_int64, c_double, c_double),
    "placed": (
        None, Longs, c_int64, c_int64, Doubles, Doubles, Doubles, Doubles, Doubles, Doubles, Longs,
        Longs, Doubles,
    ),
    "free_reach": (
        c_int64, Longs, Doubles, Bytes, c_int64, c_int64, c_double, c_double, c_double, Doubles,
    ),
    "neighbours": (
        None, Doubles, Doubles, Doubles, c_int64, c_int64, Longs, Longs, c_int64, c_double,
        c_double, Longs,
    ),
    "dilated": (c_int64, Flags, c_int64, c_int64, Longs, c_int64, Flags),
    "labels": (c_int64, Flags, c_int64, c_int64, Ints),
    "pieces": (c_int64, Doubles, c_int64, c_int64, Longs, Longs, c_int64, c_double, Longs),
    "sizes": (None, Longs),
}  # fmt: skip
"""What each function of ``engine.c`` returns and takes."""


def digest_sources(folder: Path = FOLDER) -> str | None:
    """Return the digest of the sources in ``folder``; None where there are none, as in a wheel."""
    sources = sorted([*folder.glob("*.c"), *folder.glob("*.h")])
    if not sources:
        return None
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


class Engine:
    """The functions of the library at one level of the processor, bound when first called.

    Attributes:
        path: The library.
        level: Of its functions; the highest that this processor can run by default.
    """

    def __init__(self, path: Path = LIBRARY, level: int | None = None) -> None:
        self.path = path
        self._level = level

    @cached_property
    def library(self) -> ctypes.CDLL:
        """The loaded library.

        Raises:
            FileError: It is missing, of another platform, or older than its sources.
        """
        try:
            library = ctypes.CDLL(str(self.path))
        except OSError as error:
            raise FileError(f"cannot load the compiled engine ({error}): {CURE}") from None
        wanted, found = digest_sources(), ctypes.c_char_p.in_dll(library, "engine_digest")
        built_from = ctypes.string_at(ctypes.addressof(found)).decode()
        if wanted is not None and built_from != wanted:
            raise FileError(f"the compiled engine was built from other sources: {CURE}")
        return library

    @cached_property
    def level(self) -> int:
        """Level of the functions."""
        return self._level or int(self.library.engine_level())

    def __getattr__(self, name: str) -> Any:
        """Return the function ``name``."""
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
