"""Use less memory on a robot's own small computer."""

from __future__ import annotations

import ctypes
from contextlib import suppress

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``; glibc, malloc.h."""
LARGE = 1 << 20
"""Arrays from this size on are returned one by one [bytes]; those of a sweep have 0.9 MB each. At
256 kB a tour of three_boxes holds 5 MB less and the system is busy 1.4 s longer."""


def give_back_memory() -> None:
    """Make the C library return freed memory to the system at once, where it is glibc.

    By default glibc raises its threshold with each large array that is freed, and keeps ever more
    memory in holes between the blocks in use.
    """
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(MMAP_THRESHOLD, LARGE)
        library.mallopt(TRIM_THRESHOLD, LARGE)
