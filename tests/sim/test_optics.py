import numpy as np
import pytest

from scan3d_twin.sim.config import LidarModelConfig
from scan3d_twin.sim.optics import Materials, detected, perturbed

CONFIG = LidarModelConfig()
ONE = np.array([0])


def surface(diffuse, specular, alpha):
    return Materials(np.array([diffuse]), np.array([specular]), np.array([alpha]))


def power(material, cosine, distance):
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


@pytest.mark.parametrize(
    ("distance", "low", "high"), [(0.5, 4.0, 5.5), (2, 4.0, 6.5), (3, 6.0, 7.5)]
)
def test_noise_of_a_grey_wall_is_that_of_real_logs(distance, low, high):
    n = 20_000
    draws = np.random.default_rng(1).standard_normal(n)
    wall = surface(0.6, 0.04, 0.36)
    readings = perturbed(
        np.full(n, distance), np.full(n, power(wall, 1.0, distance)), draws, CONFIG
    )
    assert low < readings.std() * 1000 < high
    assert abs(readings.mean() - distance) <= 1.1 * CONFIG.bias


def test_weak_returns_are_noisier():
    draws = np.random.default_rng(1).standard_normal(20_000)
    near = np.full(20_000, 1.0)
    strong = perturbed(near, near, draws, CONFIG).std()
    weak = perturbed(near, near * CONFIG.threshold, draws, CONFIG).std()
    assert weak > 1.1 * strong


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
    assert materials.diffuse[paint] == materials.diffuse[plain] == CONFIG.albedo
    assert materials.alpha[paint] == materials.alpha[plain] == pytest.approx(0.36)
    assert materials.diffuse[drum] == 0.0
    assert materials.specular[drum] == pytest.approx(0.9)
    assert materials.alpha[drum] == pytest.approx(0.04)
    assert len(materials.alpha) == model.ngeom + 1
