"""The same bits on every processor: which loops of the linear algebra library are taken.

OpenBLAS, which NumPy and SciPy bring, chooses its loops by the processor, and they round
differently (0.3.31: its loops for Haswell and for SkylakeX give two models of three_boxes). NumPy's
own loops do not (2.4: with AVX-512, with AVX2 and without). Where there is AVX2, those for Haswell
are taken on all processors; with one thread, since more only get into each other's way on arrays as
small as ours, and divide sums otherwise. Whoever sets the variables keeps the choice.
"""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
FIRST = 4096
"""Characters that tell of the first processor."""


def fix_arithmetic() -> None:
    """Set what OpenBLAS reads when NumPy loads it; without effect once it is loaded."""
    if "numpy" in sys.modules:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if platform.machine() == "x86_64" and _has_avx2():
        os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")


def _has_avx2() -> bool:
    try:
        with CPUINFO.open() as file:
            return "avx2" in file.read(FIRST).split()
    except OSError:
        return False
