import math

import mujoco
import numpy as np
import pytest
from scipy.spatial import cKDTree

from scan3d_twin.sim.scenes.surface_samples import sample_geom, sample_triangles

SPACING = 0.02
GEOMS = {
    "box": ('type="box" size=".1 .2 .3"', 8 * (0.02 + 0.03 + 0.06)),
    "cylinder": ('type="cylinder" size=".15 .3"', math.tau * 0.15 * (0.6 + 0.15)),
    "sphere": ('type="sphere" size=".2"', 4 * math.pi * 0.04),
    "capsule": ('type="capsule" size=".1 .2"', math.tau * 0.1 * 0.4 + 4 * math.pi * 0.01),
    "ellipsoid": ('type="ellipsoid" size=".2 .2 .2"', 4 * math.pi * 0.04),
}


@pytest.fixture(params=GEOMS)
def geom(request):
    """A model of one geom and its true area."""
    attributes, area = GEOMS[request.param]
    xml = f"<mujoco><worldbody><geom {attributes}/></worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(xml), area


def test_the_number_of_samples_is_the_area_over_the_spacing_squared(geom):
    model, area = geom
    points, normals = sample_geom(model, 0, SPACING)
    assert len(points) == pytest.approx(area / SPACING**2, rel=0.05)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)


def test_samples_lie_on_the_surface_and_normals_point_outwards(geom):
    model, _ = geom
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points, normals = sample_geom(model, 0, SPACING)
    for point, normal in list(zip(points, normals, strict=True))[::7]:
        distance = mujoco.mj_ray(
            model, data, point + 0.05 * normal, -normal, None, 1, -1, np.zeros(1, np.int32), None
        )
        assert distance == pytest.approx(0.05, abs=1e-3)


def test_no_place_on_the_surface_is_far_from_a_sample(geom):
    model, _ = geom
    coarse, _ = sample_geom(model, 0, SPACING)
    fine, _ = sample_geom(model, 0, SPACING / 5)
    distance, _ = cKDTree(coarse).query(fine)
    assert distance.max() < 1.5 * SPACING


def test_triangles_are_sampled_by_area():
    triangles = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[5, 0, 0], [5.1, 0, 0], [5, 0.1, 0]]])
    points, normals = sample_triangles(triangles, 0.01)
    assert (points[:, 0] > 4).mean() == pytest.approx(0.01 / 1.01, rel=0.05)
    assert np.array_equal(normals, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
