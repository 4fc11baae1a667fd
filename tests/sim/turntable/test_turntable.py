"""The turntable of the twin against MuJoCo's own kinematics, and its sweeps against the scene."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from scan3d_twin.core.config import Config, MotionConfig, MountConfig, SweepConfig
from scan3d_twin.core.errors import ConfigError, MotionTimeoutError
from scan3d_twin.core.planning.surface.voxels import is_passed
from scan3d_twin.core.registration import extract_surfels
from scan3d_twin.core.scanning.calibration.extrinsics import (
    apply_mount,
    lean_axis,
    measure_turn_rate,
)
from scan3d_twin.core.scanning.patterns import find_mount, rotate_z
from scan3d_twin.core.scanning.sweep import sweep, take_panorama
from scan3d_twin.core.scanning.turning import turn_table
from scan3d_twin.core.scanning.upright import make_upright
from scan3d_twin.core.types import UNMEASURED, Pose2
from scan3d_twin.sim.config import TwinConfig
from scan3d_twin.sim.robot import open_robot, open_sim
from scan3d_twin.sim.turntable.body import CARRIED_SITE, HINGE
from scan3d_twin.sim.world import robot_spec

TABLES = ["yaw", "pitch", "roll"]
NARROW = Config(sweep=SweepConfig(width=math.radians(40.0), margin=math.radians(5.0)))


def twin(pattern, turntable="ideal", world="ideal", robot="create2"):
    return replace(TwinConfig.of(world, robot), pattern=pattern, turntable=turntable)


def listen(line):
    """Take a line, and do nothing."""


@pytest.mark.parametrize("pattern", TABLES)
@pytest.mark.parametrize("robot", ["create2", "stand"])
@pytest.mark.parametrize("angle", [0.0, 0.7, -2.1])
def test_the_point_formula_is_that_of_mujocos_hinge(pattern, robot, angle):
    model = robot_spec(robot, pattern, hinged=True).compile()
    data = mujoco.MjData(model)
    data.joint(HINGE).qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    site, base = data.site(CARRIED_SITE), data.body("base")
    mount = find_mount(pattern)
    T = mount.T_base_axis @ rotate_z(angle) @ mount.T_axis_lidar
    assert site.xpos - base.xpos == pytest.approx(T[:3, 3], abs=1e-9)
    assert site.xmat.reshape(3, 3) == pytest.approx(T[:3, :3], abs=1e-9)
    assert mount.lidar_at(angle) == pytest.approx(T)


def test_the_scan_plane_holds_the_axis_and_the_direction_ahead():
    for pattern in TABLES:
        mount = find_mount(pattern)
        normal = mount.T_base_lidar[:3, 1]
        assert normal @ mount.T_base_axis[:3, 2] == pytest.approx(0.0)
        assert normal[0] == pytest.approx(0.0)


@pytest.mark.parametrize("pattern", TABLES)
def test_beams_are_cast_from_where_the_twin_carries_the_lidar(pattern):
    with open_sim("three_boxes", 1000, twin(pattern)) as (robot, truth):
        robot.turntable.turn_to(0.8, 0.5)
        robot.clock.sleep(1.0)
        line = robot.lidar.read_line(1.0)
        seen, spec = truth.evidence(), robot.lidar.spec
        angles = robot.turntable.carried_at(line.stamp + spec.beam_times)
        mount, base = find_mount(pattern), truth.pose_at(line.stamp)
    for beam in (0, 341, 681):
        T = mount.lidar_at(angles[beam])
        e = spec.elevations[beam]
        ray = T[:3, :3] @ [math.cos(e), 0.0, math.sin(e)]
        # The mast gives way by less than 0.05 deg, the base stands within a millimetre
        assert base.rotate(ray) == pytest.approx(seen.directions[beam], abs=2e-3)
        assert base.apply(T[:3, 3]) == pytest.approx(seen.positions[beam], abs=2e-3)


class Swept:
    """A sweep by an ideal turntable, with the truth."""

    def __init__(self, pattern):
        with open_sim("three_boxes", 1000, twin(pattern)) as (robot, truth):
            self.image = sweep(robot, 0.0, NARROW, listen).image
            self.true = find_true_angles(robot, self.image)
            self.pose = truth.pose_at(robot.clock.now())
            self.off = self.compare(truth)

    def compare(self, truth):
        """Return how far readings are from what the scene has there (n,) [m]."""
        image = self.image
        outside = image.ranges > 0.4  # beyond the robot itself
        line, beam = (part[::50] for part in np.nonzero(outside))
        rays = image.directions[line, beam]
        ranges = image.ranges[line, beam]
        origins = image.points[line, beam] - ranges[:, None] * rays
        seen = truth.first_hits(self.pose.apply(origins), self.pose.rotate(rays))
        return seen - ranges


def find_true_angles(robot, image):
    times = image.stamps[:, None] + image.spec.beam_times
    return robot.turntable.carried_at(times.ravel()).reshape(times.shape)


@pytest.fixture(scope="module", params=TABLES)
def swept(request):
    return Swept(request.param)


def test_each_beam_gets_the_angle_at_which_it_was_measured(swept):
    assert np.max(np.abs(swept.image.yaws - swept.true)) < 1e-5
    assert np.ptp(swept.true[10]) > math.radians(0.2)  # a line is no plane


def test_the_play_and_the_counts_of_a_servo_leave_a_tenth_of_a_degree():
    with open_sim("three_boxes", 1000, twin("yaw", "xl330")) as (robot, _):
        errors = []
        for _ in range(2):  # one sweep to the right, one back
            image = sweep(robot, 0.0, NARROW, listen).image
            errors.append(np.degrees(image.yaws - find_true_angles(robot, image)))
        play = math.degrees(robot.turntable.play - robot.turntable.spec.play)
    # What is left of the nominal play, and the resolution of 0.088 deg
    assert np.mean(errors[0]) - np.mean(errors[1]) == pytest.approx(-play, abs=0.03)
    assert max(np.std(each) for each in errors) < 0.05


def test_the_floor_is_flat_and_the_scene_where_it_is(swept):
    image = swept.image
    floor = image.heights[np.abs(image.heights) < 0.02]
    assert np.median(np.abs(floor)) < 0.001
    assert len(swept.off) > 200
    assert np.median(np.abs(swept.off)) < 0.002
    assert np.quantile(np.abs(swept.off), 0.9) < 0.02  # edges


def test_an_upright_grid_moves_no_point(swept):
    image, upright = swept.image, make_upright(swept.image)
    assert make_upright(upright) is upright
    if image is upright:
        return  # a turntable that turns about the vertical: its lines are upright
    before = image.points[np.isfinite(image.ranges)]
    after = upright.points[np.isfinite(upright.ranges)]
    assert len(after) > 0.4 * len(before)
    distances, _ = cKDTree(before).query(after)
    assert np.max(distances) < 1e-9
    middle = upright.yaws[:, upright.spec.n_beams // 2]
    assert np.all(np.diff(middle) < 0)


def test_where_no_beam_looked_nothing_is_known_to_be_free(swept):
    upright = make_upright(swept.image)
    if swept.image is upright:
        return
    unseen = ndimage.binary_erosion(upright.codes == UNMEASURED, iterations=4)
    line, beam = (part[::20] for part in np.nonzero(unseen))
    blank = replace(upright, ranges=np.ones_like(upright.ranges))
    points = blank.points_at(line, beam)
    passed = is_passed(points, upright, 0.1)
    seen = is_passed(0.5 * swept.image.points[swept.image.ranges > 0.8][::500], upright, 0.1)
    assert len(passed) > 100
    assert not np.any(passed)
    assert np.mean(seen) > 0.5


def test_a_sweep_scans_lost_lines_again_and_the_base_stands():
    config = twin("yaw")
    config = replace(config, lidar=replace(config.lidar, line_loss=0.05))
    with open_sim("three_boxes", 1000, config) as (robot, truth):
        start, count = truth.pose_at(0.0), []
        image = sweep(robot, 0.0, NARROW, count.append).image
        moved = truth.pose_at(robot.clock.now()).distance(start)
    assert np.max(-np.diff(image.yaws[:, 341])) < math.radians(1.0)
    assert len(count) > image.n_lines
    assert moved < 1e-4


def test_a_base_with_a_turntable_turns_to_the_heading_of_a_sweep():
    with open_robot("three_boxes", 1000, twin("yaw")) as robot:
        observation = sweep(robot, 0.5, NARROW, listen)
    assert observation.T_odom_scan.yaw == pytest.approx(
        0.5, abs=MotionConfig().yaw_tolerance + 0.01
    )
    middle = observation.image.yaws[:, 341]
    assert middle[0] == pytest.approx(-middle[-1], abs=0.02)


@pytest.mark.parametrize("pattern", TABLES)
def test_a_panorama_by_the_base_is_upright_with_any_pattern(pattern):
    with open_robot("three_boxes", 1000, twin(pattern)) as robot:
        image = take_panorama(robot, Config(), listen).image
    assert make_upright(image) is image
    yaws = image.yaws[np.isfinite(image.ranges)]
    assert np.ptp(yaws) > math.radians(350.0)
    assert abs(np.median(image.heights[np.abs(image.heights) < 0.05])) < 0.01


def test_a_stand_scans_all_round_and_does_not_drive():
    with open_robot("three_boxes", 1000, twin("yaw", robot="stand")) as robot:
        assert robot.base.set_velocity(0.0, 0.0) == (0.0, 0.0)
        with pytest.raises(ConfigError, match="a stand does not drive"):
            robot.base.set_velocity(0.1, 0.0)
        image = take_panorama(robot, Config(), listen).image
        assert robot.base.odometry().T_odom_base == Pose2()
    assert np.ptp(image.yaws[:, 341]) > math.radians(355.0)


def test_a_stand_needs_a_turntable():
    with (
        pytest.raises(ConfigError, match="a stand does not turn"),
        open_robot("three_boxes", 0, twin("yaw-base", robot="stand")),
    ):
        pass


def test_a_turntable_that_is_blocked_ends_in_one_line():
    class Stuck:
        """A turntable that stays where it is."""

        def __init__(self, table):
            self.spec, self.angle, self.stop = table.spec, table.angle, table.stop

        def turn_to(self, angle, speed):
            return angle, speed

    cause = r"the turntable did not reach 57 deg in 5\.0 s"
    with (
        open_robot("three_boxes", 0, twin("yaw")) as robot,
        pytest.raises(MotionTimeoutError, match=cause),
    ):
        turn_table(robot, Stuck(robot.turntable), 1.0, 0.5)


def test_the_noise_of_an_upright_grid_is_that_of_the_lines_that_were_measured():
    with open_sim("three_boxes", 1000, twin("pitch", world="typical")) as (robot, _):
        quick = replace(NARROW, sweep=replace(NARROW.sweep, yaw_rate=math.radians(20.0)))
        image = sweep(robot, 0.0, quick, listen).image
    raw, noise = extract_surfels(image).noise, extract_surfels(make_upright(image)).noise
    assert (noise.range_sigma, noise.correlation) == (raw.range_sigma, raw.correlation)
    # By its running median the lidar errs as one of fewer readings
    assert noise.correlation > 1.5


@pytest.mark.parametrize("pattern", ["yaw", "roll"])
def test_an_axis_that_leans_is_that_of_the_calibrated_mount(pattern):
    errors = {"axis_roll": 0.02, "axis_pitch": -0.03, "mount_yaw": 0.01, "table_play": 0.5}
    exact = twin(pattern, "xl330", robot="stand")
    wrong = replace(exact, errors=replace(exact.errors, **errors))
    with open_sim("plain_wall", 0, wrong) as (robot, truth):
        robot.clock.sleep(0.2)
        robot.lidar.read_line(1.0)
        seen = truth.evidence().directions[340]  # ahead
        table = robot.turntable
    design, angle = find_mount(pattern), table.carried_at(np.zeros(1))[0]
    known = MountConfig(yaw=0.01, axis_roll=0.02, axis_pitch=-0.03)
    T = lean_axis(design.T_base_axis, 0.0, known) @ rotate_z(angle)
    T = T @ apply_mount(design.T_axis_lidar, known)
    assert T[:3, 0] == pytest.approx(seen, abs=1e-3)
    assert table.play == pytest.approx(0.5 * math.radians(1.0), rel=0.5)
    assert table.play < table.spec.play


def test_a_stand_always_sweeps_in_the_same_direction():
    narrow = replace(NARROW, sweep=replace(NARROW.sweep, yaw_rate=math.radians(90.0)))
    with open_sim("plain_wall", 0, twin("yaw", robot="stand")) as (robot, _):
        ways = []
        for side in (None, None, False):
            image = sweep(robot, 0.0, narrow, listen, rightwards=side).image
            ways.append(measure_turn_rate(image) < 0)
    assert ways == [True, True, False]


def test_a_panorama_by_the_base_is_corrected_by_the_mount_on_the_turntable():
    known = MountConfig(lateral=0.04, roll=0.03, pitch=0.02, axis_roll=0.02, axis_pitch=-0.03)
    errors = {f"mount_{name}": getattr(known, name) for name in ("lateral", "roll", "pitch")}
    errors |= {"axis_roll": known.axis_roll, "axis_pitch": known.axis_pitch}
    wrong = twin("pitch")
    wrong = replace(wrong, errors=replace(wrong.errors, **errors))
    quick = replace(NARROW, sweep=replace(NARROW.sweep, look_rate=1.5), mount=known)
    with open_sim("plain_wall", 0, wrong) as (robot, _):
        image = take_panorama(robot, quick, listen).image
    floor = image.heights[np.abs(image.heights) < 0.15]
    # Without the lean and the lever it would be off by 0.03 m at 1 m
    assert len(floor) > 1000
    assert np.percentile(np.abs(floor), 90) < 0.012
