"""The objects of benchmarks/objects.py: closed, of the wanted size, and always the same."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from object_shapes import (
    CLASSES,
    HEIGHTS,
    MESH_CASES,
    WIDTHS,
    join_boxes,
    make_object,
    place_on_floor,
)

INDICES = range(40)


@pytest.fixture(scope="module")
def objects():
    """Return all objects by index."""
    return [make_object(index) for index in INDICES]


def test_meshes_are_closed_and_face_outwards(objects):
    for mesh in [mesh for _, mesh in objects] + [place_on_floor(f()) for f in MESH_CASES.values()]:
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
        assert mesh.bounds[0] + [0, 0, 0] == pytest.approx([*-mesh.bounds[1][:2], 0.0], abs=1e-9)


def test_sizes_are_in_range_and_each_class_has_low_and_high_objects(objects):
    for name in CLASSES:
        sizes = np.array([np.ptp(mesh.bounds, axis=0) for kind, mesh in objects if kind == name])
        assert len(sizes) >= 4
        assert (sizes[:, 2] >= HEIGHTS[0] - 1e-9).all()
        assert (sizes[:, 2] <= HEIGHTS[1] + 1e-9).all()
        assert sizes[:, 2].min() < 0.35 < 0.7 < sizes[:, 2].max()
        assert (sizes[:, :2] <= np.hypot(*[WIDTHS[1]] * 2)).all()


def test_an_index_is_one_object(objects):
    for index in (0, 7, 14, 21, 28, 35):
        name, mesh = make_object(index)
        assert name == objects[index][0]
        assert np.array_equal(mesh.vertices, objects[index][1].vertices)
        assert np.array_equal(mesh.faces, objects[index][1].faces)
    assert len({len(mesh.vertices) + mesh.volume for _, mesh in objects}) == len(objects)
    assert set(Counter(name for name, _ in objects).values()) <= {6, 7}


def test_a_union_of_boxes_has_no_inner_faces():
    union = join_boxes([((0, 0, 0), (2, 1, 1)), ((1, 0, 0), (3, 1, 1)), ((0, 0, 1), (1, 1, 2))])
    assert union.is_watertight
    assert union.volume == pytest.approx(4.0)
    assert union.area == pytest.approx(18.0)
