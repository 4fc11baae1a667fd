"""The way that was driven, laid through the viewpoints."""

from dataclasses import replace

import numpy as np
import pytest

from scan3d_twin.core.types import Pose2
from scan3d_twin.viz.track import place_track


def stamps_of(session):
    """Return the time at which each view was finished [s]."""
    return [float(view.observation.image.stamps.max()) for view in session.views]


def test_it_leads_through_the_viewpoints_as_the_alignment_places_them(session):
    views = [
        replace(view, T_world_scan=Pose2(0.3 * k, 1.0, 0.1)) for k, view in enumerate(session.views)
    ]
    moved = [
        replace(view, observation=replace(view.observation, image=replace(
            view.observation.image, stamps=view.observation.image.stamps + 100.0 * k)))
        for k, view in enumerate(views)
    ]  # fmt: skip
    aligned = replace(session, views=tuple(moved))
    odometry = [view.observation.T_odom_scan for view in aligned.views]
    track = np.array(
        [[t, p.x, p.y, p.yaw] for t, p in zip(stamps_of(aligned), odometry, strict=True)]
    )
    assert place_track(track, aligned) == pytest.approx(
        np.array([[0.3 * k, 1.0, 0.1] for k in range(3)]), abs=1e-9
    )


def test_nothing_is_known_of_it_without_a_track_or_views(session):
    track = np.zeros((2, 4))
    assert place_track(np.zeros((0, 4)), session).shape == (0, 3)
    assert place_track(track, replace(session, views=())).shape == (0, 3)
