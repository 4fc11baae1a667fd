"""The same bits on every processor: which kernels the linear algebra library uses.

OpenBLAS, which comes with NumPy and SciPy, chooses its kernels by the processor, and they round
differently (0.3.31: those for Haswell and for SkylakeX give two models of three_boxes). NumPy's own
loops do not (2.4: with AVX-512, with AVX2 and without). Where there is AVX2, the kernels for
Haswell are used on all processors. One thread is used, because several are slower on arrays as
small as ours, and add up in another order. Variables that the user has set are kept.

The package imports this first of all, so it takes ``os`` alone: ``platform`` and ``pathlib`` are
half of what its import costs.
"""

from __future__ import annotations

import os
import sys

CPUINFO = "/proc/cpuinfo"
FIRST = 4096
"""Characters that describe the first processor."""


def fix_arithmetic() -> None:
    """Set the variables that OpenBLAS reads when NumPy loads it; does nothing once it is loaded."""
    if "numpy" in sys.modules:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if os.uname().machine == "x86_64" and _has_avx2():
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


def _has_avx2() -> bool:
    try:
        with open(CPUINFO) as file:
            return "avx2" in file.read(FIRST).split()
    except OSError:
        return False
