"""The line to a device that has none, such as a stand."""

from __future__ import annotations


class NoLine:
    """A ``Transport`` on which nothing arrives, and what is sent is lost."""

    def read(self, timeout: float) -> bytes:
        """See ``Transport.read``; does not wait."""
        return b""

    def write(self, data: bytes) -> None:
        """See ``Transport.write``."""

    def set_baud(self, baud: int) -> None:
        """See ``Transport.set_baud``."""

    def set_dtr(self, on: bool) -> None:
        """See ``Transport.set_dtr``."""

    def discard_input(self) -> None:
        """See ``Transport.discard_input``."""

    def close(self) -> None:
        """See ``Transport.close``."""
