import pickle
from dataclasses import dataclass, replace

import numpy as np
import pytest
from paper import paper_config
from synthetic import observe

from scan3d_twin.core.compression import (
    CompressedArray,
    compress_fields,
    compressible,
    is_compressed,
)
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.scanning.target.extraction import extract_points
from scan3d_twin.core.types import FloatArray, Pose2

MILLIMETRES = np.random.default_rng(0).integers(20, 4095, (40, 682)) / 1000.0
RANDOM = np.random.default_rng(1)
ARRAYS = {
    "ranges": np.where(MILLIMETRES < 0.3, np.nan, MILLIMETRES),
    "codes": RANDOM.integers(-1, 19, (40, 682)),
    "headings": np.add.outer(np.linspace(0.7, -0.7, 40), np.linspace(0.0, -0.006, 682)),
    "noise": RANDOM.standard_normal((40, 682)),
    "signs and infinities": np.tile([0.0, -0.0, np.inf, -np.inf, np.nan, 1e-310], (40, 3)),
    "a column": RANDOM.standard_normal((40, 1)),
    "many of a few": np.repeat(np.arange(70_000), 3),
    "nothing": np.zeros((0, 682)),
}


def same_bits(a, b):
    """Return whether two arrays agree in shape, type and every bit."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


@pytest.mark.parametrize("name", ARRAYS)
def test_what_was_folded_unfolds_bit_by_bit(name):
    array = ARRAYS[name]
    unfolded = CompressedArray.of(array).decompress()
    assert same_bits(unfolded, array)
    assert not unfolded.flags.writeable
    assert unfolded.flags.c_contiguous


@pytest.mark.parametrize(("name", "least"), [("ranges", 2), ("codes", 8), ("headings", 5)])
def test_what_a_lidar_reads_becomes_much_smaller(name, least):
    compressed = CompressedArray.of(ARRAYS[name])
    assert least * (len(compressed.packed) + 12 * len(compressed.values)) < ARRAYS[name].nbytes


def test_other_numbers_are_refused():
    with pytest.raises(ConfigError, match="float32"):
        CompressedArray.of(np.zeros((2, 2), np.float32))


@compressible("values")
@dataclass(frozen=True)
class Holder:
    """A value with a compressible field."""

    values: FloatArray
    name: str


def test_a_folded_field_reads_as_before():
    holder = Holder(ARRAYS["ranges"], "x")
    assert holder.values is ARRAYS["ranges"]
    assert not is_compressed(holder, "values")
    compress_fields(["values"], holder)
    compress_fields(["values"], holder)
    assert is_compressed(holder, "values")
    assert same_bits(holder.values, ARRAYS["ranges"])
    assert same_bits(replace(holder, name="y").values, ARRAYS["ranges"])
    assert same_bits(pickle.loads(pickle.dumps(holder)).values, ARRAYS["ranges"])


def test_what_was_read_last_is_not_unfolded_again():
    holder = Holder(ARRAYS["ranges"].copy(), "x")
    compress_fields(["values"], holder)
    assert holder.values is holder.values


def test_an_array_that_two_share_is_folded_once():
    one = Holder(ARRAYS["headings"], "one")
    other = replace(one, name="other")
    compress_fields(["values"], one, other)
    assert is_compressed(one, "values")
    assert one.values is other.values


def test_a_field_that_may_be_folded_has_no_default():
    with pytest.raises(TypeError, match="values"):
        Holder(name="x")


def test_a_folded_image_and_the_points_on_it_read_as_before():
    image = observe(Pose2(), sigma=0.003, rng=np.random.default_rng(2)).image
    scan = extract_points(image, paper_config())
    names = [(image, name) for name in ("yaws", "ranges", "codes")]
    names += [(scan, name) for name in ("points", "lines", "beams")]
    before = [(*place, getattr(*place).copy()) for place in names]
    scan.compress(image)
    image.compress()
    scan.compress(image)
    for each, name, array in before:
        assert is_compressed(each, name)
        assert same_bits(getattr(each, name), array)
    assert len(scan) == len(before[3][2])


def test_points_that_are_not_on_the_image_are_kept_as_they_are():
    image = observe(Pose2()).image
    scan = extract_points(image, paper_config())
    moved = replace(scan, points=scan.points + 0.001)
    moved.compress(image)
    assert not is_compressed(moved, "points")
    assert np.array_equal(moved.points, scan.points + 0.001)
