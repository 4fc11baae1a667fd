"""Less memory for a run on a robot's own small computer."""

from __future__ import annotations

import ctypes
from contextlib import suppress

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``; glibc, malloc.h."""
LARGE = 4 << 20
"""Arrays from this size on are given back one by one [bytes]; a range image has 1.7 MB each."""


def give_back_memory() -> None:
    """Have the C library give freed memory back at once, where it is glibc.

    Otherwise it keeps more and more of it for itself, in holes between what is in use: it takes
    each large array that is freed for a sign that there will be more.
    """
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(MMAP_THRESHOLD, LARGE)
        library.mallopt(TRIM_THRESHOLD, LARGE)
