from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config, paper_registration
from sessions import PILASTERS, WALL, session_at

from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.mapping.surfel_store import MAX_GRIDS_IN_MEMORY, SurfelStore
from scan3d_twin.core.session import View
from scan3d_twin.core.types import Scan3D

CONFIG = paper_config(registration=paper_registration(engine="grid"))


@pytest.fixture(scope="module")
def views() -> list[View]:
    """Return three views, each the first of a session."""
    return [session_at(boxes, CONFIG).views[0] for boxes in (WALL, PILASTERS, WALL)]


def kept(store: SurfelStore) -> list[int]:
    """Return the indices of the views whose surfels are kept."""
    return list(store._kept)


def test_with_memory_to_spare_each_is_prepared_once(views: list[View]) -> None:
    store = SurfelStore(views, CONFIG)
    grids = list(store)
    assert len(store) == len(views)
    assert all(again is grid for again, grid in zip(store, grids, strict=True))


def test_else_those_asked_for_latest_are_kept(views: list[View]) -> None:
    store = SurfelStore(views, replace(CONFIG, optimize_for="memory"))
    first = store[0]
    assert store[1] is not None
    assert store[0] is first
    assert store[2] is not None
    assert kept(store) == [0, 2]
    assert len(kept(store)) == MAX_GRIDS_IN_MEMORY
    again, fresh = store[1], surfels_of(views[1], CONFIG)
    assert again is not None
    assert np.array_equal(again.rows, fresh.rows)


def test_a_view_without_surface_has_none(views: list[View]) -> None:
    nothing = Scan3D(np.zeros((0, 3)), np.zeros(0, int), np.zeros(0, int), 1)
    blind = replace(views[0], target=nothing, sweep=nothing)
    assert list(SurfelStore([blind], CONFIG)) == [None]
