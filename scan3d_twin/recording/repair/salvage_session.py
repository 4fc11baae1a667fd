"""The session of a damaged log: all views whose own records are there.

``SessionState`` wants a complete log. Where a part is missing, the views that are left keep their
poses, and the views, plans and panoramas are numbered again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan
from scan3d_twin.recording.exact_json import unpack
from scan3d_twin.recording.session_log import (
    MARK,
    SESSION,
    Mark,
    Record,
    list_types,
    mark_lengths,
    unpack_item,
)

LOST_PLAN = "lost with a damaged part of the file"
"""Reason of a plan that stands in for a lost one."""


class SalvagedLog:
    """What can be read of a session log with gaps.

    Attributes:
        mark: The latest mark that is left.
        expected: Number of views that the run recorded, as far as its log is left.
    """

    def __init__(self, records: Iterable[Record]) -> None:
        self.mark: Mark | None = None
        self.expected = 0
        self._base: Session | None = None
        self._items: dict[str, dict[int, Any]] = {name: {} for name in list_types()}
        for record in records:
            try:
                self._apply(*record)
            except FileError:
                continue  # a record that builds on a lost one

    def _apply(self, kind: str, index: int, packed: tuple[str, bytes]) -> None:
        if kind == SESSION:
            self._base = unpack(Session, packed)
        elif kind == MARK:
            lengths = mark_lengths(packed[0])
            self.mark = unpack(Mark, (packed[0], b""))
            self.expected = lengths.get("views", 0)
            for name, items in self._items.items():
                for gone in [k for k in items if k >= lengths.get(name, 0)]:
                    del items[gone]
        elif kind in self._items:
            items = self._items[kind]
            items[index] = unpack_item(list_types()[kind], items.get(index), packed)
            if kind == "views":
                self.expected = max(self.expected, index + 1)

    def session(self) -> Session | None:
        """Return the session with all views that are left; None where nothing is."""
        # Take the views by their new numbers
        if self._base is None or not self._items["views"]:
            return None
        kept = sorted(self._items["views"])
        views = [self._items["views"][k] for k in kept]
        views[0] = replace(views[0], registration=None)

        # Take the plans, one between two views at least
        plans = []
        for number, k in enumerate(kept):
            plan = self._items["plans"].get(k)
            if plan is None and number + 1 < len(kept):
                plan = _stand_in(views[number + 1])
            if plan is not None:
                plans.append(plan)

        # Number the rest again
        taken = self._items["panoramas"]
        panoramas = [(sum(k < taken[i][0] for k in kept), taken[i][1]) for i in sorted(taken)]
        misfits = [kept.index(k) for k in self._items["misfits"].values() if k in kept]
        return replace(
            self._base,
            views=tuple(views),
            plans=tuple(plans),
            panoramas=tuple(panoramas),
            misfits=tuple(misfits),
        )


def _stand_in(after: Any) -> Plan:
    """Return a plan in place of a lost one: it leads to the view ``after``."""
    return Plan(after.T_world_scan, 0.0, math.nan, False, (), LOST_PLAN)
