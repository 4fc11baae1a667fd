"""The lean median against numpy's."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scan3d_twin.core.registration.median import median


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_it_is_numpys_median(values: list[float]) -> None:
    given_values = np.array(values)
    assert median(given_values) == np.median(given_values)
    assert given_values.tolist() == values
