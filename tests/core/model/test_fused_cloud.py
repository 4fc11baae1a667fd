import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from paper import paper_config

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.model.fused_cloud import (
    Model,
    build_model,
    build_view_cloud,
    fuse_voxels,
    join_models,
    measure_scanned_share,
)
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2, read_only

HINT = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])


@pytest.fixture(scope="module")
def session() -> Session:
    """Return a session with two noisy views of the boxes."""
    rng = np.random.default_rng(0)
    start = Session(paper_config(), 0, HINT, np.array([-1.0, 0.0]))
    for y in (0.2, 0.0):
        start = integrate(start, synthetic.observe(Pose2(-0.4, y, 0.0), sigma=0.004, rng=rng))
    return start


def model_of(points, sigma=0.005, view=0):
    """Return a model of ``points`` with one normal, sigma and view."""
    n = len(points)
    normals = np.tile((-1.0, 0.0, 0.0), (n, 1))
    return Model(points, normals, np.broadcast_to(sigma, n).copy(), np.full(n, view))


def test_normals_are_those_of_the_boxes_and_face_the_lidar(session):
    model = build_view_cloud(session.views[0]).model
    front = (np.abs(model.points[:, 0] - 0.65) < 0.02) & (model.points[:, 2] < 0.6)
    front &= (model.points[:, 1] > -1.1) & (model.points[:, 1] < -0.3)
    assert front.sum() > 500
    tilt = np.degrees(np.arccos(-model.normals[front, 0]))
    assert np.median(tilt) < 6
    eye = session.views[0].T_world_scan.apply(np.array([0.0, 0.0, 0.3]))
    assert np.mean(np.sum(model.normals * (eye - model.points), axis=1) > 0) > 0.99


def test_oblique_readings_are_worth_less_than_square_ones():
    wall = (synthetic.Box((1.0, -3.0, 0.0), (1.2, 3.0, 1.0)),)
    view = integrate(
        Session(paper_config(), 0, np.array([[1.0, 0.0]]), np.array([-1.0, 0.0])),
        synthetic.observe(Pose2(), wall, room=False, width=math.radians(150)),
    ).views[0]
    model = build_view_cloud(view).model
    bearing = np.abs(np.arctan2(model.points[:, 1], model.points[:, 0]))
    square, oblique = model.sigma[bearing < 0.1], model.sigma[bearing > 1.2]
    assert len(oblique) > 20
    assert oblique.min() > 1.5 * square.max()


def test_a_stray_reading_is_an_outlier_and_a_surface_seen_flat_is_not(session):
    view = session.views[0]
    assert len(build_view_cloud(view).cleaned) > 0.98 * len(view.target)
    lines, beams = view.target.lines[::50], view.target.beams[::50]
    ranges = np.array(view.image.ranges)
    ranges[lines, beams] -= 0.3
    moved = replace(view.image, ranges=read_only(ranges))
    strayed = replace(view, image=moved, target=view.target.with_points_of(moved))
    assert len(view.target) - len(build_view_cloud(strayed).cleaned) >= 0.95 * len(lines)
    flat = np.broadcast_to(0.3 / np.cos(np.radians(78) + view.image.yaws / 100), ranges.shape)
    wall = replace(view.image, ranges=read_only(np.array(flat)))
    square = replace(view, image=wall, target=view.target.with_points_of(wall))
    assert len(build_view_cloud(square).cleaned) == len(view.target)


def test_a_voxel_weighs_its_points_by_their_variance():
    good = model_of(np.array([[0.002, 0.005, 0.005]]), sigma=0.001, view=3)
    poor = model_of(np.array([[0.008, 0.005, 0.005]]), sigma=0.003, view=1)
    far = model_of(np.array([[0.512, 0.005, 0.005]]), view=2)
    fused = fuse_voxels(join_models([poor, good, far]), 0.01)
    assert len(fused) == 2
    np.testing.assert_allclose(fused.points[0], [(9 * 0.002 + 0.008) / 10, 0.005, 0.005])
    assert fused.sigma[0] == pytest.approx(0.003 / math.sqrt(10))
    assert list(fused.view) == [3, 2]
    np.testing.assert_allclose(fused.normals, [[-1, 0, 0], [-1, 0, 0]])


def test_fusing_brings_the_model_nearer_to_the_surface(session):
    raw, fused = build_model(session), build_model(session, voxel=0.02)
    assert len(fused) < len(raw) / 4

    def error(model):
        side = (model.points[:, 1] > -1.1) & (model.points[:, 1] < -0.3)
        side &= (np.abs(model.points[:, 0] - 0.65) < 0.05) & (model.points[:, 2] < 0.6)
        side &= model.points[:, 2] > 0.05  # cells on the floor hold few points
        return np.std(model.points[side & (np.abs(model.normals[:, 0]) > 0.9), 0])

    assert error(fused) < 0.7 * error(raw)


def test_the_model_is_all_points_of_the_target_but_outliers(session):
    model = build_model(session)
    clouds = [view.T_world_scan.apply(view.target.points) for view in session.views]
    points = np.concatenate(clouds)
    view = np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    assert 0.98 * len(points) < len(model) <= len(points)
    among = {tuple(row) for row in np.column_stack([points, view])}
    assert all(tuple(row) in among for row in np.column_stack([model.points, model.view]))


def test_no_views_are_no_points():
    empty = Session(paper_config(), 0, HINT, np.array([-1.0, 0.0]))
    assert len(build_model(empty, voxel=0.01)) == len(build_model(empty)) == 0
    assert measure_scanned_share(empty) == 0


def test_the_scanned_share_grows_with_the_views(session):
    first = replace(session, views=session.views[:1])
    assert 0.3 < measure_scanned_share(first) <= measure_scanned_share(session) <= 1
    around = replace(session, config=paper_config(tour="full"))
    assert 0 < measure_scanned_share(around) < 1
