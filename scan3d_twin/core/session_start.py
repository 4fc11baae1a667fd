"""The start of a session: a panorama, the target in it, and the first viewpoint.

``begin_session`` takes the panorama; ``start_session`` is pure, as are the corrections of the
configuration by what the panorama shows.
"""

from __future__ import annotations

from dataclasses import replace

from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.costmap import build_costmap
from scan3d_twin.core.observer import Observer
from scan3d_twin.core.planning.standoff import fit_standoff
from scan3d_twin.core.scanning.calibration.lidar_mount import (
    apply_yaw_scale,
    calibrate_on_panorama,
    describe_suspicion,
)
from scan3d_twin.core.scanning.sweep import take_panorama
from scan3d_twin.core.scanning.target.selection import find_target, is_empty
from scan3d_twin.core.session import Session
from scan3d_twin.core.stand import start_stand_session
from scan3d_twin.core.types import Observation, Pose2
from scan3d_twin.core.viewpoints import (
    choose_viewpoint,
    extract_panorama_contour,
    find_first_segment,
    measure_sweep_width,
)


def begin_session(
    robot: Robot,
    config: Config,
    seed: int,
    observer: Observer,
    target: tuple[float, float] | None,
) -> tuple[Session, Pose2]:
    """Take a panorama; return an empty session and the first viewpoint in ``odom``.

    At 1.5 m the lines of a panorama are 5 cm apart, and a pole of 3 cm may stand between two: if
    nothing seems to stand there, the robot looks again with half that spacing.
    """
    observer.on_event("looking around for the target")
    panorama = take_panorama(robot, config, observer.on_line)
    if target is None and is_empty(panorama, config):
        observer.on_event("nothing stands free: looking around again, more slowly")
        panorama = take_panorama(robot, halve_look_rate(config), observer.on_line)

    # Check the extrinsics and the yaw scale
    found = calibrate_on_panorama(panorama.image)
    if warning := describe_suspicion(found):
        observer.on_event(f"warning: {warning}")
    tuned = apply_yaw_scale(config, found)
    if tuned != config:
        observer.on_event(f"turns are corrected by {tuned.mount.yaw_scale:+.2%}")

    # Choose target and first viewpoint
    here = robot.base.odometry().T_odom_base
    if robot.base.spec.is_stand:
        return start_stand_session(panorama, here, tuned, seed, target), here
    session, viewpoint = start_session(panorama, here, tuned, seed, target)
    standoff = session.config.planning.standoff
    if standoff != tuned.planning.standoff:
        observer.on_event(f"standoff {standoff:.2f} m, by the height of the target")
    return session, viewpoint


def halve_look_rate(config: Config) -> Config:
    """Return ``config`` with half the angle between the lines of a look around."""
    return replace(config, sweep=replace(config.sweep, look_rate=config.sweep.look_rate / 2))


def tune_config(session: Session, config: Config) -> Config:
    """Return ``config`` for a run that continues ``session``, tuned by its first panorama."""
    if not session.panoramas:
        return config
    panorama = session.panoramas[0][1]
    tuned = apply_yaw_scale(config, calibrate_on_panorama(panorama.image))
    return fit_standoff(tuned, panorama, session.hint)


def start_session(
    panorama: Observation,
    here: Pose2,
    config: Config,
    seed: int,
    target: tuple[float, float] | None,
) -> tuple[Session, Pose2]:
    """Return an empty session and the first viewpoint in ``odom``, from a panorama.

    Pure: the same arguments give the same result.

    Args:
        panorama: The panorama.
        here: Where the robot stands in ``odom``.
        config: The effective configuration.
        seed: The run's one seed.
        target: Place (x, y) in ``odom`` [m] of the target; the most salient thing by default.

    Raises:
        SceneError: There is no target.
        ScanError: No viewpoint of the target can be reached.
    """
    # Find the target
    hint = find_target(panorama, target, config)
    config = fit_standoff(config, panorama, hint)
    contour = extract_panorama_contour(here.inverse().apply(hint))
    session = Session(config, seed, hint, here.rotate(contour.normal(0)), ((0, panorama),))

    # Choose the first viewpoint
    costmap = build_costmap(session.observations(), config, here, workspace=session.workspace)
    segment = find_first_segment(
        contour, measure_sweep_width(config), from_left=config.tour == "front"
    )

    def feasible(viewpoint: Pose2) -> bool:
        there = here @ viewpoint
        return costmap.is_feasible(there.x, there.y)

    viewpoint, _ = choose_viewpoint(segment, config, feasible)
    if viewpoint is None:
        raise ScanError(
            "no viewpoint of the target can be reached; clear the floor in front of it, or allow "
            "another planning.standoff"
        )
    return session, here @ viewpoint
