"""Views of a scanner that is set down by hand: a session without odometry.

The first view defines the world. Each further one is found in the model so far by
``register_globally``, without any prior, and then all views are aligned together, so that loops
between them close.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import RegistrationError
from scan3d_twin.core.mapping.global_registration import (
    Located,
    register_globally,
    transfer_result,
)
from scan3d_twin.core.mapping.loop_closure import align
from scan3d_twin.core.mapping.scan_matching import surfels_of
from scan3d_twin.core.mapping.surfel_store import SurfelStore
from scan3d_twin.core.registration.surfels.sweep_points import SweepPoints
from scan3d_twin.core.scanning.gap_filling import fill_gaps
from scan3d_twin.core.scanning.mixed_pixels import remove_mixed_pixels
from scan3d_twin.core.scanning.target.extraction import extract_points, extract_target
from scan3d_twin.core.scanning.target.selection import find_target
from scan3d_twin.core.scanning.upright import make_upright
from scan3d_twin.core.session import Session, View
from scan3d_twin.core.target_growth import extend_targets
from scan3d_twin.core.types import (
    Observation,
    Plan,
    Pose2,
    RangeImage,
    Scan3D,
    read_only,
)

HINT_POINTS = 2000
"""Largest number of points of the hint where everything is modelled."""


def begin_placed_session(observation: Observation, config: Config, seed: int = 0) -> Session:
    """Return the session of the first view of a scanner that is set down by hand.

    Args:
        observation: The view; its ``has_odometry`` is False.
        config: The effective configuration.
        seed: The run's one seed.

    Raises:
        SceneError: There is no salient target, and only that is to be modelled.
    """
    observation = replace(observation, image=make_upright(observation.image))
    if config.target.extraction == "everything":
        points = extract_everything(observation.image, config).points
        hint = points[:: max(1, len(points) // HINT_POINTS), :2]
    else:
        hint = find_target(observation, None, config)
    middle = hint.mean(axis=0) if len(hint) else np.array([1.0, 0.0])
    front = -middle / max(float(np.linalg.norm(middle)), 1e-9)
    session = Session(config, seed, read_only(hint), read_only(front))
    return integrate_placed(session, observation)


def integrate_placed(session: Session, observation: Observation) -> Session:
    """Return ``session`` with the view that ``observation`` makes, found without odometry.

    Pure: the same session and observation give the same result.

    Raises:
        RegistrationError: The view fits nowhere.
    """
    # Clean the range image
    config = session.config
    image = fill_gaps(remove_mixed_pixels(observation.image, config.gaps), config.gaps)
    points = extract_points(image, config)
    nothing = points.select(np.zeros(len(points), dtype=bool))
    view = View(observation, image, nothing, points, Pose2(), None)

    # Find it in the model so far
    if session.views:
        located = _locate(view, session)
        previous = session.views[-1].T_world_scan
        reference = session.views[located.reference].T_world_scan
        result = transfer_result(located.result, previous.inverse() @ reference)
        view = replace(view, T_world_scan=located.T_world_scan, registration=result)
        if len(session.plans) < len(session.views):
            session = session.with_plan(_describe_placement(located, config))

    # Extract the target there, and align all views
    view = replace(view, target=_extract_target(view, session))
    session = extend_targets(session.with_view(view))
    aligned = session.config.alignment.mode != "off" and len(session.views) > 1
    return align(session) if aligned else session


def _locate(view: View, session: Session) -> Located:
    """Return where ``view`` lies in the model so far; errors as for ``integrate_placed``."""
    config, views = session.config, session.views
    try:
        return register_globally(
            tuple(SurfelStore(views, config)),
            [each.T_world_scan for each in views],
            surfels_of(view, config),
        )
    except RegistrationError as error:
        raise RegistrationError(f"view {len(views)}: {error}") from None


def _describe_placement(located: Located, config: Config) -> Plan:
    """Return where the scanner was set down, as the plan that led there.

    Its error is that of the registration, which the true one exceeds in one of ten views.
    """
    expected = config.registration.calibration * located.result.predicted_rmse
    return Plan(
        viewpoint=located.T_world_scan,
        overlap=located.overlap,
        predicted_rmse=expected if math.isfinite(expected) else math.nan,
        fell_back=False,
        candidates=(),
        reason="set down by hand",
    )


def _extract_target(view: View, session: Session) -> Scan3D:
    """Return the points of ``view``, whose pose is known, that are modelled."""
    config = session.config
    if config.target.extraction == "everything":
        return extract_everything(view.image, config)
    known = view.T_world_scan.inverse().apply(session.gather_known_target())
    return extract_target(view.image, view.sweep, known, config.target)


def extract_everything(image: RangeImage, config: Config) -> Scan3D:
    """Return all points of ``image`` within range, except the scanner itself."""
    with np.errstate(invalid="ignore"):
        keep = image.ranges <= config.target.max_range
    points, lines, beams, distance = SweepPoints.of(image, keep)
    everything = Scan3D(points, lines, beams, image.n_lines)
    return everything.select(distance > config.motion.self_radius)
