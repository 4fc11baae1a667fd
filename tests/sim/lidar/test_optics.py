import numpy as np
import pytest

from scan3d_twin.sim.config import LidarModelConfig
from scan3d_twin.sim.lidar.config import UNFILTERED_LIDAR
from scan3d_twin.sim.lidar.firmware import _is_detected as detected
from scan3d_twin.sim.lidar.noise import range_sigma
from scan3d_twin.sim.lidar.optics import Materials

CONFIG = LidarModelConfig()
ONE = np.array([0])


def surface(diffuse, specular, alpha):
    """Return a material of one geom."""
    alpha2 = np.array([alpha**2])
    return Materials(np.array([diffuse / np.pi]), specular * alpha2 / np.pi, alpha2, None)


def power(material, cosine, distance):
    """Return the power of a hit on the material."""
    return float(material.power(ONE, np.array([cosine]), np.array([distance]))[0])


def test_a_white_wall_at_one_metre_returns_its_albedo_over_pi():
    assert power(surface(0.9, 0.0, 0.36), 1.0, 1.0) == pytest.approx(0.9 / np.pi)


def test_power_falls_with_the_square_of_the_distance():
    wall = surface(0.6, 0.04, 0.36)
    assert power(wall, 0.7, 1.0) == pytest.approx(4 * power(wall, 0.7, 2.0))


def test_ten_per_cent_grey_is_at_the_threshold_at_4_2_metres():
    assert power(surface(0.1, 0.0, 0.36), 1.0, 4.2) == pytest.approx(CONFIG.threshold, rel=0.01)


def test_a_mirror_like_metal_returns_from_straight_ahead_only():
    chrome = surface(0.0, 0.9, 0.01)
    assert power(chrome, 1.0, 1.0) > 100 * power(surface(0.9, 0.04, 0.36), 1.0, 1.0)
    assert power(chrome, np.cos(np.radians(20)), 1.0) < CONFIG.threshold


def test_detection_is_even_at_the_threshold_and_certain_far_from_it():
    draws = np.random.default_rng(0).standard_normal(4000)
    shares = [
        detected(np.full(4000, factor * CONFIG.threshold), draws, CONFIG).mean()
        for factor in (0.1, 1.0, 10.0)
    ]
    assert shares[0] < 0.01
    assert shares[1] == pytest.approx(0.5, abs=0.03)
    assert shares[2] > 0.99


def sigma_mm(distance, cosine=1.0, material=None, config=CONFIG):
    """Return the range noise [mm] on a material."""
    wall = surface(0.6, 0.04, 0.36) if material is None else material
    at = np.array([distance])
    strength = np.array([power(wall, cosine, distance)])
    return 1000 * float(range_sigma(at, strength, np.array([cosine]), config)[0])


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.2])
def test_noise_of_a_step_depends_on_the_power_alone(cosine):
    assert sigma_mm(1.0, cosine) == pytest.approx(4.3, abs=0.2)


def test_unfiltered_noise_grows_with_incidence_as_measured_on_the_sibling():
    # UBG-04LX-F01, medians 2.6, 3.0, 3.9, 3.9, 4.5 mm at 0, 20, 40, 60, 80 deg.
    angles, measured = (20, 40, 60, 80), np.array([3.0, 3.9, 3.9, 4.5]) / 2.6
    sigmas = [sigma_mm(1.0, np.cos(np.radians(angle)), config=UNFILTERED_LIDAR) for angle in angles]
    ratios = np.array(sigmas) / sigma_mm(1.0, config=UNFILTERED_LIDAR)
    assert np.all(np.diff(ratios) > 0)
    assert ratios == pytest.approx(measured, rel=0.15)


def test_weak_returns_are_noisier():
    dark = surface(0.05, 0.0, 0.36)
    assert sigma_mm(1.9, material=dark) > 1.05 * sigma_mm(1.9)


def test_materials_are_read_from_metallic_and_roughness_alone(scene_of):
    head = (
        '<asset><material name="shiny_paint" specular="1" shininess="1" reflectance="1"/>'
        '<material name="chrome" metallic="1" roughness="0.2"/></asset>'
    )
    body = (
        '<geom name="target" size=".1" material="shiny_paint"/>'
        '<geom name="drum" size=".1" material="chrome"/><geom name="plain" size=".1"/>'
    )
    model = scene_of(body, head=head).model
    materials = Materials.of(model, CONFIG)
    paint, drum, plain = (model.geom(name).id for name in ("target", "drum", "plain"))
    assert materials.diffuse[paint] == pytest.approx(CONFIG.albedo / np.pi)
    assert materials.diffuse[plain] == pytest.approx(0.5 / np.pi)
    assert materials.alpha2[paint] == materials.alpha2[plain] == pytest.approx(0.36**2)
    assert materials.diffuse[drum] == 0.0
    assert materials.specular[drum] == pytest.approx(0.9 * 0.04**2 / np.pi)
    assert materials.alpha2[drum] == pytest.approx(0.04**2)
    assert len(materials.alpha2) == model.ngeom + 1
    assert materials.retro is None
