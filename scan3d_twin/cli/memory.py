"""Use less memory on a robot's own small computer."""

from __future__ import annotations

import ctypes
from contextlib import suppress

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``; glibc, malloc.h."""
LARGE = 4 << 20
"""Arrays from this size on are returned one by one [bytes]; a range image has 1.7 MB each."""


def give_back_memory() -> None:
    """Make the C library return freed memory to the system at once, where it is glibc.

    By default glibc raises its threshold with each large array that is freed, and keeps ever more
    memory in holes between the blocks in use.
    """
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(MMAP_THRESHOLD, LARGE)
        library.mallopt(TRIM_THRESHOLD, LARGE)
