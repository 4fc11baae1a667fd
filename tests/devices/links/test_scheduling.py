"""Slices of processor time that a process asks for."""

import ctypes
import os
import platform

import pytest

from scan3d_twin.devices.links import scheduling
from scan3d_twin.devices.links.scheduling import SLICE_NS, request_slices, short_slices

GET = {"x86_64": 315, "aarch64": 275}
"""Number of ``sched_getattr``; Linux, syscall_64.tbl and asm-generic/unistd.h."""


def slice_now():
    """Return the slice of this thread [ns]; Linux before 6.12 returns 0."""
    data = ctypes.create_string_buffer(56)
    call = ctypes.c_long(GET[platform.machine()])
    assert ctypes.CDLL(None).syscall(call, 0, data, len(data), 0) == 0
    return int.from_bytes(data.raw[24:32], "little")


def test_slices_are_short_for_a_while_and_the_priority_stays():
    before, nice = slice_now(), os.nice(0)
    if not before:
        pytest.skip("this kernel has one length of slices for all")
    with short_slices():
        assert slice_now() == SLICE_NS < before
        assert os.nice(0) == nice
    assert slice_now() == before


def test_a_machine_whose_calls_are_not_known_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(scheduling.platform, "machine", lambda: "riscv64")
    assert not request_slices(SLICE_NS)
    with short_slices():
        pass
