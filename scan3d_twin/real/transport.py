"""Seam B: bytes between a driver and its device."""

from __future__ import annotations

from typing import Protocol


class Transport(Protocol):
    """A line to a device."""

    def read(self, timeout: float) -> bytes:
        """Return what has arrived, waiting up to ``timeout`` [s] for the first byte; else ``b""``.

        Raises:
            LinkError: The device is unplugged.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send all of ``data`` at once.

        Raises:
            LinkError: The device is unplugged.
        """
        ...

    def set_baud(self, baud: int) -> None:
        """Send and receive at ``baud`` [bit/s] from now on."""
        ...

    def discard_input(self) -> None:
        """Forget what has arrived and was not read."""
        ...

    def close(self) -> None:
        """Give the port back; closing twice does nothing."""
        ...
