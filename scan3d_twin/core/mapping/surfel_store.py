"""A store of the surfels of many views: all in memory, or the latest few if memory is short."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from typing import Protocol

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.scan_matching import select_points, surfels_of
from scan3d_twin.core.registration import SurfelGrid
from scan3d_twin.core.session import View
from scan3d_twin.core.types import FloatArray

MAX_GRIDS_IN_MEMORY = 2
"""Surfel grids kept when optimising for memory, enough to compare two views; each takes 13 MB."""


class Grids(Protocol):
    """The surfel grid of each view by its index; None for a view without a surface."""

    def __len__(self) -> int: ...

    def __getitem__(self, k: int, /) -> SurfelGrid | None: ...


class SurfelStore:
    """``Grids`` that are extracted when they are first needed."""

    def __init__(self, views: Sequence[View], config: Config) -> None:
        self._views, self._config = views, config
        self._most = MAX_GRIDS_IN_MEMORY if config.optimize_for == "memory" else len(views)
        self._kept: OrderedDict[int, SurfelGrid | None] = OrderedDict()

    def __len__(self) -> int:
        return len(self._views)

    def __iter__(self) -> Iterator[SurfelGrid | None]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: int) -> SurfelGrid | None:
        """Return the surfel grid of view ``k``, extracted anew unless it is kept."""
        if k not in self._kept:
            while len(self._kept) >= self._most:
                self._kept.popitem(last=False)
            self._kept[k] = self._extract(k)
        self._kept.move_to_end(k)
        return self._kept[k]

    def points(self, k: int) -> FloatArray:
        """Return the points (n, 3) [m] of view ``k`` by which it is registered without surfels."""
        return select_points(self._views[k], self._config)

    def _extract(self, k: int) -> SurfelGrid | None:
        try:
            return surfels_of(self._views[k], self._config)
        except RegistrationError:
            return None
