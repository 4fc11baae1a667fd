import math
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from paper import paper_config

from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.model.fused_cloud import build_view_cloud, build_view_clouds
from scan3d_twin.core.model.mesh import build_mesh, triangulate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2, read_only

HINT = np.array([[0.62, y] for y in np.linspace(-1.1, 1.1, 23)])


def session_of(*observations):
    """Return a session with these views of the boxes."""
    session = Session(paper_config(), 0, HINT, np.array([-1.0, 0.0]))
    for observation in observations:
        session = integrate(session, observation)
    return session


@pytest.fixture(scope="module")
def session():
    """Return a session with two views of the boxes, without noise."""
    return session_of(*(synthetic.observe(Pose2(-0.4, y, 0.0)) for y in (0.2, 0.0)))


def distance_to_boxes(points):
    """Return the distance of each of ``points`` (n, 3) from the nearest box."""

    def distance(box):
        low, high = np.array(box.low), np.array(box.high)
        outside = np.linalg.norm(np.maximum(0, np.maximum(low - points, points - high)), axis=1)
        inside = np.minimum(points - low, high - points).min(axis=1)
        return np.maximum(outside, inside)

    return np.min([distance(box) for box in synthetic.THREE_BOXES], axis=0)


def test_triangles_lie_on_the_boxes_and_face_the_lidar(session):
    mesh = build_mesh(session, build_view_clouds(session))
    assert len(mesh.faces) > 5000
    points = mesh.sample(2000, np.random.default_rng(0))
    assert np.quantile(distance_to_boxes(points), 0.95) < 0.006
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    eye = np.array([[v.T_world_scan.x, v.T_world_scan.y, 0.3] for v in session.views])
    towards = eye[mesh.view[mesh.faces[:, 0]]] - corners.mean(axis=1)
    assert np.all(np.sum(normal * towards, axis=1) > 0)


def test_the_gap_between_two_boxes_is_not_bridged(session):
    view = session.views[0]
    mesh = triangulate(view, build_view_cloud(view))
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    gap = (middle[:, 1] > -0.24) & (middle[:, 1] < -0.16) & (middle[:, 0] < 0.72)
    assert not np.any(gap & (middle[:, 2] < 0.38))
    corners = mesh.vertices[mesh.faces]
    longest = max(np.linalg.norm(corners[:, i] - corners[:, i - 1], axis=1).max() for i in range(3))
    assert longest < 0.09


def test_missing_readings_stay_a_hole_though_the_model_fills_them():
    whole = synthetic.observe(Pose2(-0.4, -0.7, 0.0))
    ranges, codes = whole.image.ranges.copy(), whole.image.codes.copy()
    ranges[58:63, 330:334], codes[58:63, 330:334] = np.nan, 0
    holed = replace(whole.image, ranges=read_only(ranges), codes=read_only(codes, np.int64))
    views = [session_of(replace(whole, image=image)).views[0] for image in (whole.image, holed)]
    assert len(views[0].target) == len(views[1].target)
    full, less = (triangulate(view, build_view_cloud(view)) for view in views)
    corners_left_whole = 2
    assert len(full.faces) - len(less.faces) == 2 * (5 + 1) * (4 + 1) - corners_left_whole


def test_where_views_overlap_one_is_kept(session):
    views = [triangulate(v, build_view_cloud(v, k)) for k, v in enumerate(session.views)]
    both = build_mesh(session, build_view_clouds(session))
    separate = sum(mesh.areas.sum() for mesh in views)
    assert max(mesh.areas.sum() for mesh in views) < both.areas.sum() < 0.75 * separate
    assert set(both.view) == {0, 1}


def test_samples_are_spread_by_area(session):
    mesh = build_mesh(session, build_view_clouds(session))
    points = mesh.sample(4000, np.random.default_rng(0))
    corners = mesh.vertices[mesh.faces]
    low = corners.mean(axis=1)[:, 2] < 0.3
    share = mesh.areas[low].sum() / mesh.areas.sum()
    assert np.mean(points[:, 2] < 0.3) == pytest.approx(share, abs=5 * math.sqrt(0.25 / 4000))


def test_a_session_without_views_is_an_empty_mesh():
    mesh = build_mesh(session_of(), [])
    assert (len(mesh.vertices), len(mesh.faces)) == (0, 0)
    assert mesh.sample(10, np.random.default_rng(0)).shape == (0, 3)
