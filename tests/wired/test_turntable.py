"""The driver of the servo on its emulator on the twin: as good as the twin's turntable itself."""

from dataclasses import replace

import numpy as np
import pytest
from paper import paper_config

from scan3d_twin.core.scanning.sweep import sweep
from scan3d_twin.devices.dynamixel.model import COUNT
from scan3d_twin.devices.links.line_model import Wire
from scan3d_twin.devices.registry import turntable_device
from scan3d_twin.real.robot import CarriedTurntable, tap_turntable
from scan3d_twin.recording.image import image_bytes
from scan3d_twin.recording.recorder import SerialTaps
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_sim
from scan3d_twin.wired import HazardFreeClock, open_wired


@pytest.mark.parametrize("world", ["ideal", "typical"])
def test_its_angles_are_those_of_the_servo_at_their_times(world):
    config = replace(TwinConfig.of(world), pattern="yaw")
    config = replace(config, turntable="ideal" if world == "ideal" else "xl330")
    device = turntable_device("xl330")
    with open_sim("three_boxes", 5, config) as (twin, _):
        clock = HazardFreeClock(twin.clock)
        emulated = device.emulate(twin.turntable)
        driver = device.open_driver(lambda: Wire(emulated, clock), clock)
        start = clock.now()
        for goal, speed in ((1.0, 0.4), (-0.5, 1.0), (0.0, 0.1)):
            driver.turn_to(goal, speed)
            until = clock.now() + 2.5
            while clock.now() < until:
                clock.sleep(0.005)
                driver.service(clock.now())
        samples = driver.angles_since(start)
        motion = twin.turntable._motion
        off = [each.angle - motion.servo_at(each.stamp)[0] for each in samples]
    # Half a count where it is exact; else the noise of the sensor, and 1 ms at 0.4 rad/s
    assert len(samples) > 1000
    assert driver.bad == 0
    assert abs(np.median(off)) < 0.25 * COUNT
    assert np.percentile(np.abs(off), 95) < (0.75 if world == "ideal" else 1.5) * COUNT


def test_one_seed_gives_the_same_bytes():
    images = []
    for _ in range(2):
        config = replace(TwinConfig.of("typical"), pattern="yaw")
        quick = replace(paper_config(), sweep=replace(paper_config().sweep, yaw_rate=0.4))
        with open_wired("three_boxes", 3, config) as (robot, _):
            images.append(image_bytes(sweep(robot, 0.0, quick, lambda line: None)))
    assert images[0] == images[1]


@pytest.mark.parametrize("pattern", ["yaw-base", "roll"])
def test_the_wired_robot_knows_how_its_lidar_is_mounted(pattern):
    config = replace(TwinConfig.of("ideal"), pattern=pattern)
    config = replace(config, lidar_roll=0.3 if pattern == "yaw-base" else 0.0)
    mounts = []
    for opener in (open_sim, open_wired):
        with opener("plain_wall", 0, config) as (robot, _):
            mounts.append((robot.T_base_lidar, robot.T_base_axis))
    (lidar, axis), (wired_lidar, wired_axis) = mounts
    assert np.array_equal(lidar, wired_lidar)
    assert (axis is None) == (wired_axis is None) == (pattern == "yaw-base")
    assert axis is None or np.array_equal(axis, wired_axis)


def test_the_bytes_of_its_line_are_for_the_record():
    device, taps, heard = turntable_device("xl330"), SerialTaps(), set()
    taps.listener = lambda topic, stamp, direction, data: heard.add((topic, direction))
    with open_sim("plain_wall", 5, replace(TwinConfig.of("ideal", "stand"), pattern="yaw")) as (
        twin, _,
    ):  # fmt: skip
        emulated, clock = device.emulate(twin.turntable), HazardFreeClock(twin.clock)
        carried = CarriedTurntable(
            "xl330", lambda: Wire(emulated, clock), twin.T_base_axis, twin.T_base_lidar
        )
        tapped = tap_turntable(carried, clock, taps)
        device.open_driver(tapped.open_line, clock).turn_to(0.1, 0.5)
    assert heard == {("/serial/turntable", ">"), ("/serial/turntable", "<")}
