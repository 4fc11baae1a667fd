"""Whether the base follows its drive commands, by the commanded speeds that it reports.

A byte lost or altered may make the base wait for the rest of a long command, and take all drive
commands that follow for that: for seconds it drives on as it was told before, or as nobody told it.
"""

from __future__ import annotations

from collections import deque
from typing import Literal

PATIENCE = 0.1
"""Time that the base may need to report a drive command [s]: six periods; assumption."""
MAX_ORDERS = 5
"""Number of drive commands that it may still report when one is sent every 30 ms: 0.15 s."""

Speeds = tuple[int, int]
"""Speeds of the (right, left) wheel [mm/s]."""
Remedy = Literal["none", "repeat", "complete and repeat"]


class OrderWatch:
    """Compares the commanded speeds that the base reports with those it was sent."""

    def __init__(self, now: float) -> None:
        self._orders: deque[Speeds] = deque([(0, 0)], MAX_ORDERS)
        self._sent_at = self._obeyed_at = now
        self._repeats = 0

    def send(self, speeds: Speeds, now: float) -> None:
        """Note that ``speeds`` are commanded at ``now`` [s]."""
        self._orders.append(speeds)
        self._sent_at = now

    def check(self, reported: Speeds, now: float, *, is_safe: bool) -> Remedy:
        """Return what to do about the latest command.

        A command that was repeated in vain is to be repeated after what completes any other.

        Args:
            reported: Commanded speeds that the base reports.
            now: Current time [s].
            is_safe: Whether the base obeys drive commands at all.
        """
        on_its_way = now - self._sent_at <= PATIENCE and reported in self._orders
        if reported == self._orders[-1] or on_its_way or not is_safe:
            self._obeyed_at, self._repeats = max(now, self._obeyed_at), 0
            return "none"
        if now - self._obeyed_at <= PATIENCE:
            return "none"
        self._obeyed_at, self._repeats = now, self._repeats + 1
        return "repeat" if self._repeats == 1 else "complete and repeat"

    def excuse(self, seconds: float) -> None:
        """Allow ``seconds`` more until the next repetition: the line is busy."""
        self._obeyed_at += seconds
