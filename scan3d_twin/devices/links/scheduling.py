"""Short slices of processor time, so that ports are served in time on a busy computer.

A process that serves ports needs little time, but soon: beside several that compute, it otherwise
waits for its turn for up to half a second. Since Linux 6.12 a process may ask for slices of its own
length, without any privilege: it gets no more time than before, in shorter pieces and therefore
earlier (EEVDF; ``sched_setattr`` with ``sched_runtime`` for SCHED_OTHER). Older kernels ignore it.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
from collections.abc import Iterator
from contextlib import contextmanager

SLICE_NS = 100_000
"""Length of a slice [ns]: the shortest that Linux gives (``__setparam_fair``, kernel/sched)."""
_CALLS = {"x86_64": 314, "aarch64": 274}
"""Number of ``sched_setattr``; Linux, syscall_64.tbl and asm-generic/unistd.h."""
_ATTRIBUTES = struct.Struct("=IIQiIQQQ")
"""``struct sched_attr``: its size, policy, flags, nice, priority, runtime, deadline and period."""


@contextmanager
def short_slices() -> Iterator[None]:
    """Run the calling thread in slices of ``SLICE_NS`` for the time of the context."""
    request_slices(SLICE_NS)
    try:
        yield
    finally:
        request_slices(0)


def request_slices(length: int) -> bool:
    """Ask for slices of ``length`` [ns] for the calling thread; 0 is the default of the system.

    Returns:
        Whether the system took the request; an older one may take and ignore it.
    """
    number = _CALLS.get(platform.machine())
    policy, nice = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    if number is None or policy != os.SCHED_OTHER:
        return False
    data = _ATTRIBUTES.pack(_ATTRIBUTES.size, policy, 0, nice, 0, length, 0, 0)
    call = ctypes.CDLL(None).syscall
    return bool(call(ctypes.c_long(number), 0, ctypes.create_string_buffer(data), 0) == 0)
