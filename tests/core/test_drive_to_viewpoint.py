from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic import JumpingClock, KinematicBase
from paper import paper_config
from synthetic import Box, observe

from scan3d_twin.core.config import MotionConfig
from scan3d_twin.core.drive_to_viewpoint import BACK_OFF_LENGTH, drive
from scan3d_twin.core.errors import HazardError, MotionTimeoutError, ScanError
from scan3d_twin.core.hal import Robot
from scan3d_twin.core.navigation.costmap import FREE, RESOLUTION, build_costmap
from scan3d_twin.core.navigation.motion_control import back_off, follow_path
from scan3d_twin.core.observer import Unobserved
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Hazards, Observation, Pose2
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.sim.scenes.load import load_scene

pytestmark = pytest.mark.slow

CONFIG = paper_config()
GLASS_HOUSE = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="5 5 0.1"/>
  <geom name="north" type="box" pos="0 2.5 1" size="3 0.05 1"/>
  <geom name="south" type="box" pos="0 -2.5 1" size="3 0.05 1"/>
  <geom name="east" type="box" pos="3 0 1" size="0.05 2.5 1"/>
  <geom name="west" type="box" pos="-1.5 0 1" size="0.05 2.5 1"/>
  <geom name="glass" type="box" pos="0.8 0 0.5" size="0.02 0.4 0.5" rgba="1 1 1 0"/>
  <body name="target_box" pos="2.5 0 0.3"><geom name="box" type="box" size="0.2 0.3 0.3"/></body>
  <site name="spawn" pos="0 0 0"/>
</worldbody></mujoco>
"""


def look(boxes: tuple[Box, ...], here: Pose2) -> Observation:
    """Return a panorama of ``boxes``."""
    return observe(here, boxes, width=math.tau - 1e-3, step=math.radians(2.0))


def at(place: Pose2) -> tuple[Robot, KinematicBase]:
    """Return a robot without a lidar that stands at ``place`` in ``odom``."""
    base = KinematicBase()
    base._samples[0] = replace(base._samples[0], T_odom_base=place)
    return Robot(base, None, JumpingClock(base)), base  # type: ignore[arg-type]


def executed(base: KinematicBase) -> FloatArray:
    """Return the path (n, 2) that the base has driven."""
    poses = [sample.T_odom_base for sample in base.odometry_since(0.0)]
    return np.array([[pose.x, pose.y] for pose in poses])


@settings(max_examples=12, deadline=None)
@given(
    boxes=st.lists(
        st.tuples(st.floats(-1.5, 1.2), st.floats(-1.5, 1.2), st.floats(0.1, 0.6)),
        min_size=1,
        max_size=4,
    ),
    x=st.floats(-2.0, 2.0),
    y=st.floats(-1.6, 1.6),
)
def test_the_body_never_leaves_the_floor_that_was_seen(
    boxes: list[tuple[float, float, float]], x: float, y: float
) -> None:
    """Along the executed path everything under the robot is free: seen, and nothing on it."""
    start = Pose2(-2.0, -1.5, 0.3)
    blocks = tuple(Box((a, b, 0.0), (a + s, b + s, 0.5)) for a, b, s in boxes)
    costmap = build_costmap((look(blocks, start),), CONFIG, start)
    path = costmap.find_path(x, y)
    if path is None:
        return
    robot, base = at(start)
    follow_path(robot, path, CONFIG.motion)
    way = executed(base)
    assert math.dist(way[-1], (x, y)) <= 2 * CONFIG.motion.position_tolerance
    i, j = np.indices(costmap.cells.shape)
    middles = costmap.origin + (np.stack([i, j], axis=-1) + 0.5) * RESOLUTION
    lethal = middles[costmap.cells != FREE]
    away = np.hypot(*(lethal - costmap.start).T) > CONFIG.motion.robot_radius + 0.1
    for place in way[:: max(1, len(way) // 200)]:
        distance = np.hypot(*(lethal[away] - place).T)
        assert distance.min() > CONFIG.motion.robot_radius


def test_backing_off_goes_straight_back_and_stops() -> None:
    robot, base = at(Pose2(1.0, 1.0, 0.5))
    back_off(robot, 0.12, CONFIG.motion)
    moved = Pose2(1.0, 1.0, 0.5).inverse() @ base.odometry().T_odom_base
    assert moved.x == pytest.approx(-0.12, abs=0.015)
    assert (moved.y, moved.yaw) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert base.speed == (0.0, 0.0)


def test_what_was_touched_stays_an_obstacle_whatever_the_lidar_says() -> None:
    here = Pose2()
    clear = look((), here)
    touched = ((0.5, 0.0),)
    assert build_costmap((clear,), CONFIG, here).is_feasible(0.5, 0.0)
    assert not build_costmap((clear,), CONFIG, here, touched).is_feasible(0.5, 0.0)
    felt = replace(clear, touched=touched)
    assert not build_costmap((felt, clear), CONFIG, here).is_feasible(0.5, 0.0)


class Recorder(Unobserved):
    """Observer that collects the events."""

    def __init__(self) -> None:
        self.events: list[str] = []

    def on_event(self, text: str) -> None:
        self.events.append(text)


@pytest.fixture
def glass_house(tmp_path) -> Iterator[Robot]:  # type: ignore[no-untyped-def]
    """Yield a robot in front of a pane of glass."""
    path = tmp_path / "glass_house.xml"
    path.write_text(GLASS_HOUSE)
    with open_sim(load_scene(str(path)), 0, TwinConfig.ideal()) as (robot, _):
        yield robot


def session_of(observation: Observation, retries: int = 3) -> Session:
    """Return a session that begins with a panorama and allows ``retries`` bumps."""
    motion = MotionConfig(bump_retries=retries)
    front = np.array([-1.0, 0.0])
    config = replace(CONFIG, motion=motion)
    return Session(config, 0, np.array([[2.3, 0.0]]), front, ((0, observation),))


def first_look(robot: Robot) -> Observation:
    """Return a panorama from where the robot stands."""
    from scan3d_twin.core.scanning.sweep import take_panorama

    return take_panorama(robot, CONFIG, lambda line: None)


def test_a_pane_of_glass_is_touched_once_and_gone_around(glass_house: Robot) -> None:
    observer = Recorder()
    session = session_of(first_look(glass_house))
    touched = drive(glass_house, Pose2(1.4, 0.0, 0.0), session, observer)
    assert 3 <= len(touched) <= 40
    for x, y in touched:
        assert 0.6 < x < 1.0
        assert abs(y) < 1.0
    assert any("backing off" in event for event in observer.events)
    poses = [sample.T_odom_base for sample in glass_house.base.odometry_since(0.0)]
    assert poses[-1].distance(Pose2(1.4, 0.0)) < 0.03
    crossing = [b.y for a, b in pairwise(poses) if a.x < 0.8 <= b.x]
    assert crossing
    assert all(abs(y) > 0.4 for y in crossing)
    assert glass_house.base.hazards().active() == ()


def test_without_retries_the_first_bump_ends_the_run(glass_house: Robot) -> None:
    session = session_of(first_look(glass_house), retries=0)
    with pytest.raises(HazardError, match="bump"):
        drive(glass_house, Pose2(1.4, 0.0, 0.0), session, Unobserved())


class Faulty(KinematicBase):
    """A base on which something goes wrong 0.3 m ahead."""

    def __init__(self, hazard: Hazards) -> None:
        super().__init__()
        self.fault = hazard

    def set_velocity(self, linear: float, angular: float) -> tuple[float, float]:
        if linear > 0 and self.odometry().T_odom_base.x > 0.3:
            super().set_velocity(0.0, 0.0)
            self.hazard = self.fault
            raise HazardError(f"stopped: {', '.join(self.fault.active())}")
        return super().set_velocity(linear, angular)


@pytest.mark.parametrize(
    "hazard",
    [
        Hazards(cliff_front_left=True),
        Hazards(wheel_drop_left=True),
        Hazards(bump_left=True, wheel_drop_right=True),
        Hazards(bump_right=True, overcurrent_left=True),
    ],
)
def test_anything_but_a_bump_ends_the_run(hazard: Hazards) -> None:
    base = Faulty(hazard)
    robot = Robot(base, None, JumpingClock(base))  # type: ignore[arg-type]
    session = session_of(look((), Pose2()))
    with pytest.raises(HazardError):
        drive(robot, Pose2(1.0, 0.0, 0.0), session, Unobserved())
    assert base.speed == (0.0, 0.0)
    assert base.odometry().T_odom_base.x > 0.3  # it did not back off


def test_no_way_is_an_error_after_a_look(monkeypatch: pytest.MonkeyPatch) -> None:
    from scan3d_twin.core import drive_to_viewpoint as driving

    looks = []
    monkeypatch.setattr(driving, "take_panorama", lambda *_: looks.append(1) or look((), Pose2()))
    robot, _ = at(Pose2())
    with pytest.raises(ScanError, match="no way"):
        drive(robot, Pose2(9.0, 0.0, 0.0), session_of(look((), Pose2())), Unobserved())
    assert looks == [1]


def test_blocked_wheels_are_an_obstacle_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from scan3d_twin.core import drive_to_viewpoint as driving

    robot, _ = at(Pose2())
    calls = []

    def blocked_once(robot: Robot, path: FloatArray, config: MotionConfig) -> None:
        calls.append(path)
        if len(calls) == 1:
            raise MotionTimeoutError("wheels blocked")
        follow_path(robot, path, config)

    monkeypatch.setattr(driving, "follow_path", blocked_once)
    monkeypatch.setattr(
        driving, "take_panorama", lambda *_: look((), Pose2(-BACK_OFF_LENGTH, 0.0, 0.0))
    )
    touched = drive(robot, Pose2(1.0, 0.0, 0.0), session_of(look((), Pose2())), Unobserved())
    assert len(touched) == 5
    assert all(0.15 < x < 0.25 for x, _ in touched)
    assert len(calls[1]) > len(calls[0])  # no longer straight
