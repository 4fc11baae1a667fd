"""The serial line between an emulated device and its client."""

from __future__ import annotations

from typing import Protocol


class Device(Protocol):
    """An emulated device: bytes in, bytes out, on the simulated clock and nothing else."""

    @property
    def baud(self) -> int:
        """What its UART is set to [bit/s]; 0 where the line has no speed (USB)."""
        ...

    def receive(self, data: bytes, now: float) -> None:
        """Take in ``data`` that arrived by ``now`` [s]."""
        ...

    def transmit(self, now: float) -> bytes:
        """Return the bytes it has put on the line since the last call, up to ``now`` [s]."""
        ...
