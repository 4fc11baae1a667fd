import math
from dataclasses import dataclass, field, make_dataclass, replace
from types import GenericAlias, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from same import same

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.types import FloatArray, Plan, Pose2, read_only
from scan3d_twin.recording.exact_json import (
    are_equal,
    is_array,
    pack,
    pack_fields,
    unpack,
    unpack_fields,
)


def test_a_session_comes_back_bit_by_bit(session):
    assert same(unpack(Session, pack(session)), session)


def test_arrays_refuse_writes_and_are_shared_as_before(session):
    view = unpack(View, pack(session.views[0]))
    assert view.image.yaws is view.observation.image.yaws
    with pytest.raises(ValueError, match="read-only"):
        view.image.yaws[0, 0] = 1.0


def test_an_array_is_told_by_its_hint_also_where_that_is_an_alias() -> None:
    """As NDArray is on Python 3.12 and later with numpy 2.5: it only stands for the class."""
    alias = SimpleNamespace(__value__=np.ndarray[Any, np.dtype[Any]])
    assert is_array(GenericAlias(alias, (np.float64,)))  # type: ignore[arg-type]
    assert is_array(FloatArray)
    assert not is_array(tuple[float, ...])
    assert not is_array(float)


@given(st.floats(), st.floats(), st.integers(), st.text(st.characters(exclude_categories=["Cs"])))
def test_any_number_and_text(x, y, n, text):
    value = (x, y, n, text)
    assert same(unpack(tuple[float, float, int, str], pack(value)), value)


@given(
    st.sampled_from(["f8", "f4", "i8", "i2", "u1", "?"]).flatmap(
        lambda kind: arrays(kind, array_shapes(min_dims=0, max_dims=3, min_side=0))
    )
)
@example(np.array([-1, 2**53 + 1]))
@example(np.array([-1, 2**63 - 1]))
def test_any_array(array):
    assert same(unpack(FloatArray, pack(array)), array)


def test_only_what_changed_is_packed(session):
    view = session.views[1]
    moved = replace(view, T_world_scan=Pose2(1.0, 2.0, 3.0))
    packed = pack_fields(moved, view)
    assert len(packed[0]) + len(packed[1]) < 100
    assert replace(view, **unpack_fields(View, packed)).T_world_scan == Pose2(1.0, 2.0, 3.0)


def test_fields_of_other_versions_do_not_matter():
    old = make_dataclass("Thing", [("x", float), ("gone", int)])
    new = make_dataclass("Thing", [("x", float), ("added", int, field(default=7))])
    assert unpack(new, pack(old(0.5, 1))) == new(0.5, 7)


@dataclass
class Pair:
    """Two arrays, possibly one object."""

    first: float
    second: FloatArray


@pytest.mark.parametrize(
    "packed",
    [("{}", b""), ('{"first":1,"second":["<f8",[3],"<f8",0]}', b"short"), ("[", b""), ("3", b"")],
    ids=["a field is missing", "an array is cut", "no JSON", "no fields"],
)
def test_what_does_not_fit_is_a_broken_file(packed):
    with pytest.raises(FileError, match="no valid Pair in the file"):
        unpack(Pair, packed)


@pytest.mark.parametrize("shape", ["[-1]", "[2,-1]", "[-1,-1]", "[1.0]", "[true]", '["1"]'])
def test_a_shape_is_of_whole_numbers_from_zero_on(shape):
    """A shape of -1 would return the whole blob, and more with each array."""
    packed = f'{{"first":1,"second":["<f8",{shape},"<f8",0]}}', bytes(64)
    with pytest.raises(FileError, match="no valid Pair in the file: an array"):
        unpack(Pair, packed)


def test_what_cannot_be_recorded_is_a_mistake():
    with pytest.raises(TypeError, match="cannot record a set"):
        pack({1})


def test_json_is_strict():
    plan = Plan(None, 0.0, math.nan, False, (), "done")
    assert "NaN" not in pack(plan)[0]
    assert same(unpack(Plan, pack(plan)), plan)


def test_whole_numbers_take_no_more_room_than_they_need():
    assert len(pack(np.arange(800, dtype=np.int64))[1]) == 1600


def test_values_are_equal_whichever_of_their_arrays_are_one_object() -> None:
    """A view that changed later is written apart, and shares no arrays with what was written."""
    array = read_only(np.arange(4.0))
    together, apart = (array, array), (array, read_only(np.arange(4.0)))
    assert pack(together) != pack(apart)
    assert are_equal(together, apart)
    assert not are_equal(together, (array, read_only(np.arange(4.0) + 1e-15)))
    assert not are_equal(together, (array, read_only(np.arange(5.0))))
