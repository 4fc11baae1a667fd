from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scan3d_twin.core.planning.surface.set_cover import Cover, solve_chain_cover, solve_set_cover
from scan3d_twin.core.types import BoolArray


def cover(sees: BoolArray, needed: float | None = None) -> Cover:
    """Return a problem of equal pieces; all that can be seen is needed by default."""
    weights = np.ones(sees.shape[1])
    needed = float(sees.any(axis=0).sum()) if needed is None else needed
    return Cover(sees, weights, needed, np.zeros(len(sees)))


def strip(starts: list[int], width: int, length: int) -> BoolArray:
    """Return views that each see ``width`` pieces of a strip from their start on."""
    pieces = np.arange(length)
    return np.array([(pieces >= start) & (pieces < start + width) for start in starts])


def smallest(sees: BoolArray, needed: float) -> int:
    """Return the size of a smallest cover, by trying all."""
    for size in range(len(sees) + 1):
        for chosen in combinations(range(len(sees)), size):
            if sees[list(chosen)].any(axis=0).sum() >= needed:
                return size
    raise AssertionError


@settings(max_examples=25)
@given(st.integers(0, 10_000), st.floats(0.3, 1.0))
def test_no_smaller_cover_exists(seed: int, share: float) -> None:
    sees = np.random.default_rng(seed).random((7, 15)) < 0.3
    needed = np.floor(share * sees.any(axis=0).sum())
    found = solve_set_cover(cover(sees, needed))
    assert found is not None
    assert len(found) == smallest(sees, needed)
    assert sees[found].any(axis=0).sum() >= needed


def test_a_greedy_choice_would_need_three() -> None:
    pieces = np.arange(6)
    sees = np.array([(pieces >= 1) & (pieces <= 4), pieces < 3, pieces >= 3])
    found = solve_set_cover(cover(sees))
    assert found is not None
    assert found.tolist() == [1, 2]


def test_of_equal_covers_the_cheaper_one() -> None:
    sees = np.ones((2, 3), dtype=bool)
    found = solve_set_cover(Cover(sees, np.ones(3), 3.0, np.array([0.1, 0.0])))
    assert found is not None
    assert found.tolist() == [1]


def test_more_overlap_needs_more_views() -> None:
    sees = strip(list(range(0, 31)), 10, 40)
    counts = []
    for overlap in (0, 2, 5, 8):
        shared = sees.astype(int) @ sees.T.astype(int)
        chain = solve_chain_cover(cover(sees), shared >= overlap, np.arange(31) == 0)
        assert chain is not None
        assert chain[0] == 0
        assert sees[chain].any(axis=0).all()
        assert all(shared[a, b] >= overlap for a, b in pairwise(chain))
        counts.append(len(chain))
    assert counts == [4, 5, 7, 16]


def test_no_chain_across_a_gap() -> None:
    sees = strip([0, 20], 10, 30)
    assert (
        solve_chain_cover(cover(sees), np.zeros((2, 2), dtype=bool), np.array([True, False]))
        is None
    )
    assert solve_set_cover(cover(sees)) is not None


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_no_start_no_chain(share: float) -> None:
    sees = strip([0, 5], 10, 15)
    follows = np.ones((2, 2), dtype=bool)
    assert solve_chain_cover(cover(sees, 15 * share), follows, np.zeros(2, dtype=bool)) is None
