"""Sweeps written as other scanners write them give the points that they were."""

from __future__ import annotations

import math
import pickle
import sqlite3
from contextlib import closing
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import other_scanners
import pytest
import synthetic
from rosbags.rosbag2 import StoragePlugin
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scan3d_twin.core.errors import ConfigError, FileError
from scan3d_twin.core.scanning.patterns import find_axis_mount, find_mount
from scan3d_twin.core.scanning.upright import make_upright
from scan3d_twin.core.types import Pose2, RangeImage
from scan3d_twin.recording.checks import check_image
from scan3d_twin.recording.importing.assemble import Mount, assemble, estimate_height
from scan3d_twin.recording.importing.readings import Readings, split_sweeps
from scan3d_twin.recording.importing.source import ImportOptions, read_sweeps
from scan3d_twin.recording.importing.turning_frame import FrameTree
from scan3d_twin.recording.mcap.ros_messages import make_message, typestore

KNOWN = ImportOptions(Mount("yaw", (0.05, 0.0, 0.0), height=0.30))


def ignore(_: str) -> None:
    """Take no notice of what was assumed."""


@cache
def sweep() -> RangeImage:
    """Return a sweep of an axis that turns on while lines are measured."""
    lidar = synthetic.spec(171)
    lidar = replace(lidar, elevations=4.0 * lidar.elevations, max_range=4.1)
    seen = synthetic.observe(
        Pose2(-0.3, 0.2, 0.4), width=math.radians(120), step=math.radians(1.5), lidar=lidar
    )
    return other_scanners.turn_like_a_robot(seen.image)


def same_points(found: RangeImage, true: RangeImage) -> float:
    """Return the largest distance of points [m], after the turn to the middle of the sweep."""
    middle = (float(true.yaws[0].mean()) + float(true.yaws[-1].mean())) / 2
    turned = Pose2(0.0, 0.0, middle).apply(found.points)
    assert np.array_equal(np.isnan(turned), np.isnan(true.points))
    return float(np.nanmax(np.linalg.norm(turned - true.points, axis=-1)))


@pytest.mark.parametrize("units", ["s,deg,deg,m", "ms,rad,deg,mm"])
def test_a_csv_file_of_readings_gives_the_same_points(tmp_path, units):
    other_scanners.write_readings(tmp_path / "scan.csv", sweep(), units=units)
    (found,) = read_sweeps(tmp_path / "scan.csv", KNOWN, ignore)
    check_image(found)
    assert same_points(found, sweep()) < 1e-5


def test_a_csv_file_of_lines_gives_the_same_points(tmp_path):
    other_scanners.write_lines(tmp_path / "scan.csv", sweep())
    (found,) = read_sweeps(tmp_path / "scan.csv", KNOWN, ignore)
    check_image(found)
    assert same_points(found, sweep()) < 1e-4


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_laser_scans_with_transforms_give_the_same_points_and_mount(tmp_path, storage):
    other_scanners.write_laser_scans(tmp_path / "bag", sweep(), storage=storage)
    (found,) = read_sweeps(tmp_path / "bag", ImportOptions(Mount(height=0.0)), ignore)
    check_image(found)
    assert np.allclose(found.T_base_lidar, sweep().T_base_lidar, atol=1e-9)
    assert same_points(found, sweep()) < 1e-4
    assert found.spec.max_range == pytest.approx(sweep().spec.max_range)


def test_laser_scans_in_one_mcap_file_with_a_joint(tmp_path):
    other_scanners.write_laser_scans(tmp_path / "bag", sweep(), joint=True)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    (found,) = read_sweeps(path, KNOWN, ignore)
    assert same_points(found, sweep()) < 1e-4
    (named,) = read_sweeps(path, replace(KNOWN, joint="pan"), ignore)
    assert np.array_equal(named.yaws, found.yaws)
    with pytest.raises(FileError, match="no joint 'tilt'; joints: pan, wheel"):
        read_sweeps(path, replace(KNOWN, joint="tilt"), ignore)
    with pytest.raises(FileError, match="on: /lidar/scan"):
        read_sweeps(path, replace(KNOWN, topic="/scan"), ignore)


def test_the_height_of_the_lidar_is_told_by_the_floor(tmp_path):
    other_scanners.write_readings(tmp_path / "scan.csv", sweep())
    told: list[str] = []
    (found,) = read_sweeps(tmp_path / "scan.csv", ImportOptions(), told.append)
    assert found.T_base_lidar[2, 3] == pytest.approx(0.30, abs=0.002)
    assert "0.30 m above the floor" in told[0]


def test_files_of_a_folder_are_read_in_their_natural_order(tmp_path):
    for name, step in (("scan10.csv", 1.5), ("scan2.csv", 3.0)):
        image = synthetic.observe(
            Pose2(), width=math.radians(90), step=math.radians(step), lidar=synthetic.spec(60)
        ).image
        other_scanners.write_readings(tmp_path / name, image)
    first, second = read_sweeps(tmp_path, KNOWN, ignore)
    assert first.n_lines < second.n_lines


def readings(axis, *, places=None, period=0.1) -> Readings:
    """Return readings of 30 beams per line, with the axis at ``axis`` (n,) [rad]."""
    n, beams = len(axis), np.linspace(-1.0, 1.0, 30)
    return Readings(
        "scan",
        np.repeat(np.arange(n), 30),
        (np.arange(n)[:, None] * period + np.linspace(0, 0.05, 30)).ravel(),
        np.repeat(np.asarray(axis, dtype=np.float64), 30),
        np.tile(beams, n),
        np.full(30 * n, 2.0),
        places=None if places is None else np.repeat(places, 30, axis=0),
    )


def test_a_sweep_there_and_back_is_two():
    there = np.radians(np.arange(-40.0, 40.0))
    wait = np.full(25, there[-1])
    found = split_sweeps(readings([*there, *wait, *there[::-1]]))
    assert [len(each) // 30 for each in found] == pytest.approx([80, 78], abs=2)
    assert [each.origin for each in found] == ["scan, sweep 0", "scan, sweep 1"]


def test_two_turns_one_after_the_other_are_two_sweeps():
    turn = np.radians(np.arange(0.0, 360.0, 2.0))
    assert len(split_sweeps(readings([*turn, *turn]))) == 2


def test_lines_of_a_drive_are_left_out():
    turn = np.radians(np.arange(-40.0, 40.0))
    drive = np.linspace(0.0, 1.0, 50)[:, None] * [1.0, 0.0, 0.0]
    places = np.concatenate([np.zeros((80, 3)), drive, np.tile([1.0, 0.0, 0.0], (80, 1))])
    axis = [*turn, *np.radians(np.linspace(40.0, -40.0, 50)), *turn]
    found = split_sweeps(readings(axis, places=places))
    assert [len(each) // 30 for each in found] == pytest.approx([80, 80], abs=1)


def test_too_short_a_sweep_is_refused():
    with pytest.raises(FileError, match="no sweep from one place of 20 lines over 10 deg"):
        split_sweeps(readings(np.radians(np.linspace(0.0, 5.0, 100))))


def test_lines_of_their_own_angles_keep_each_reading():
    rng = np.random.default_rng(3)
    plain = readings(np.radians(np.arange(-30.0, 30.0)))
    shifted = replace(
        plain,
        angles=plain.angles + np.repeat(rng.uniform(-0.02, 0.02, 60), 30),
        ranges=rng.uniform(1.0, 3.0, len(plain)),
    )
    image = assemble(shifted, Mount())
    check_image(image)
    assert np.count_nonzero(np.isfinite(image.ranges)) == len(plain)
    c, s = np.cos(shifted.angles), np.sin(shifted.angles)
    heights = np.sort(shifted.ranges * s)
    assert np.allclose(np.sort(image.points[np.isfinite(image.ranges)][:, 2]), heights)
    assert float(np.nanmax(image.ranges * c.max())) <= 3.0


def test_a_lidar_that_sees_all_round_keeps_all_its_readings():
    n, beams = 60, np.radians(np.arange(0.0, 360.0, 3.0))
    rng = np.random.default_rng(5)
    axis = np.radians(np.linspace(0.0, 180.0, n))
    ranges = rng.uniform(1.0, 3.0, n * len(beams))
    image = assemble(
        Readings(
            "scan", np.repeat(np.arange(n), len(beams)), None, np.repeat(axis, len(beams)),
            np.tile(beams, n), ranges,
        ),
        Mount("yaw", (0.0, -0.02, 0.0)),
    )  # fmt: skip
    check_image(image)
    assert np.allclose(np.sort(image.ranges.ravel()), np.sort(ranges))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no data"),
        ("time_s,axis_deg,angle_deg,range_m\n", "holds no data"),
        ("a,b,c\n1,2,3\n", "no column axis"),
        ("axis,angle_deg,range_m\n1,2,3\n", "'axis' states no known unit"),
        ("axis_deg,angle_deg,range_m\n1,2,3\n1,2,x\n", "line 3: could not convert"),
        ("axis_deg,angle_deg,range_m\n1,2,3\n1\n", "line 3: 1 columns, too few"),
        ("axis_deg,angle_deg,range_m\n1,nan,3\n", "column angle has fields that are no number"),
        ("axis_deg,angle_deg,range_m\n1,2,0\n1,3,0\n", "no reading has a range"),
        ("axis_deg,angle_deg,range_m\n1,2,1500\n1,3,1600\n", "range_mm is in mm"),
        ("# beam_s: soon\naxis_deg,angle_deg,range_m\n1,2,3\n", "states no time"),
        ("axis_deg,angle_deg,range_m\n" + "1,2,3\n" * 30, "no sweep from one place"),
    ],
)
def test_a_wrong_csv_file_is_refused_by_name(tmp_path, text, message):
    (tmp_path / "scan.csv").write_text(text)
    with pytest.raises(FileError, match=message):
        read_sweeps(tmp_path / "scan.csv", ImportOptions(), ignore)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "scan.csv").write_bytes(bytes(range(256)))
    with pytest.raises(FileError, match="no text in UTF-8"):
        read_sweeps(tmp_path / "scan.csv", ImportOptions(), ignore)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cloud.ply", "holds points"),
        ("log.bag", "ROS 1"),
        ("scan.docx", "of no known type"),
        ("scan.mcap", "is no session file"),
        ("scan.db3", "no database of rosbag2"),
    ],
)
def test_other_files_are_refused_by_name(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / name).write_bytes(b"something else")
    with pytest.raises(FileError, match=message):
        read_sweeps(tmp_path / name, ImportOptions(), ignore)


def test_a_database_of_other_things_is_refused(tmp_path):
    with closing(sqlite3.connect(tmp_path / "bag.db3")) as database:
        database.execute("CREATE TABLE topics (id INTEGER, name TEXT, type TEXT)")
        database.execute("CREATE VIEW messages AS SELECT 1 AS topic_id, 2 AS timestamp, 3 AS data")
        database.commit()
    with pytest.raises(FileError, match="no database of rosbag2: no tables"):
        read_sweeps(tmp_path / "bag.db3", ImportOptions(), ignore)


def test_an_empty_folder_and_a_missing_file_are_refused(tmp_path):
    with pytest.raises(FileError, match="holds no sweeps"):
        read_sweeps(tmp_path, ImportOptions(), ignore)
    with pytest.raises(FileError, match="there is no"):
        read_sweeps(tmp_path / "nowhere", ImportOptions(), ignore)


def test_scans_that_nothing_turns_are_refused(tmp_path):
    image = sweep()
    still = replace(image, yaws=np.zeros_like(image.yaws))
    other_scanners.write_laser_scans(tmp_path / "bag", still)
    with pytest.raises(FileError, match="nothing turns the frame 'laser'"):
        read_sweeps(tmp_path / "bag", ImportOptions(), ignore)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,3,4", "a,b,c", "1,2,inf"])
def test_a_wrong_mount_is_refused(text):
    with pytest.raises(ConfigError, match="--mount must be"):
        Mount().parse(text)


def test_a_plane_across_the_axis_is_refused():
    flat = Mount("yaw", (0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2))
    with pytest.raises(FileError, match="sweeps nothing"):
        assemble(readings(np.radians(np.arange(-30.0, 30.0))), flat)


@pytest.mark.parametrize("pattern", ["pitch", "roll"])
def test_a_plane_that_is_pitched_or_rolled_gives_the_points_of_the_room(tmp_path, pattern):
    """The points of a box room are on its walls, its floor and its ceiling."""
    image = tilted(pattern)
    other_scanners.write_readings(tmp_path / "scan.csv", image)
    (found,) = read_sweeps(tmp_path / "scan.csv", ImportOptions(Mount(pattern)), ignore)
    check_image(found)
    upright = make_upright(found)
    for each in (found, upright):
        points = each.points[np.isfinite(each.ranges)]
        assert distance_to_room(points).max() < 0.01
    assert np.count_nonzero(np.isfinite(upright.ranges)) > 3000


@pytest.mark.parametrize("pattern", ["pitch", "roll"])
def test_transforms_tell_that_a_plane_is_pitched_or_rolled(tmp_path, pattern):
    other_scanners.write_laser_scans(tmp_path / "bag", tilted(pattern))
    (found,) = read_sweeps(tmp_path / "bag", ImportOptions(Mount(height=0.5)), ignore)
    points, true = found.points[np.isfinite(found.ranges)], tilted(pattern).points
    assert np.allclose(np.sort(points[:, 2]), np.sort(true[np.isfinite(true[..., 2])][:, 2]),
                       atol=1e-3)  # fmt: skip


ROOM = np.array([[-2.5, 2.5], [-2.0, 2.0], [0.0, 2.5]])


def distance_to_room(points):
    """Return the distance of points (n, 3) to the nearest wall, floor or ceiling (n,) [m]."""
    return np.min(np.abs(points[:, :, None] - ROOM), axis=(1, 2))


def tilted(pattern: str) -> RangeImage:
    """Return a sweep of a bare room from its middle, by a tilting axis at 0.5 m."""
    mount = find_mount(pattern)
    assert mount is not None
    T_scan_axis = mount.T_base_axis.copy()
    T_scan_axis[2, 3] = 0.5
    lidar = replace(synthetic.spec(91), elevations=np.linspace(-2.0, 2.0, 91), max_range=6.0)
    stamps = np.arange(90) * 0.1 + other_scanners.START
    times = stamps[:, None] + lidar.beam_times
    yaws = -np.radians(12.0) * (times - times.mean())
    ones = np.ones(yaws.shape)
    rotated = find_axis_mount(mount.T_base_axis, mount.T_base_lidar)
    rotated[:3, 3] = 0.0
    image = RangeImage(
        stamps, yaws, ones, np.full(yaws.shape, -1), lidar, rotated, T_scan_axis=T_scan_axis
    )
    rays = image.directions
    with np.errstate(divide="ignore"):
        exits = (ROOM.T[:, None, None, :] - [0.0, 0.0, 0.5]) / rays
    ranges = np.min(np.max(exits, axis=0), axis=-1)
    return replace(image, ranges=ranges)


@pytest.mark.parametrize("protocol", [4, 5])
def test_a_raw_scan_of_pilidar_gives_the_points_that_its_own_program_makes(tmp_path, protocol):
    image = sweep()
    image = replace(image, yaws=np.repeat(image.yaws[:, :1], image.spec.n_beams, axis=1))
    other_scanners.write_pilidar(tmp_path / "240824-1230_lidar.pkl", image, protocol=protocol)
    options = ImportOptions(Mount(height=0.0))
    (found,) = read_sweeps(tmp_path / "240824-1230_lidar.pkl", options, ignore)
    check_image(found)

    # As merge_2D_points: rotate about y by the offset angle, shift along y, rotate about z
    e, r = image.spec.elevations, image.ranges
    plane = np.stack([r * np.cos(e), np.zeros_like(r), r * np.sin(e)], axis=-1)
    tilted = Rotation.from_rotvec([0.0, math.radians(-1.05), 0.0]).apply(plane.reshape(-1, 3))
    shifted = tilted + np.array([0.0, -0.0375, 0.0])
    z_angles = np.repeat(-image.yaws[:, 0], len(e))
    turned = Rotation.from_rotvec(np.outer(-z_angles, [0.0, 0.0, 1.0])).apply(shifted)
    middle = (image.yaws[0, 0] + image.yaws[-1, 0]) / 2
    points = Pose2(0.0, 0.0, middle).apply(found.points[np.isfinite(found.ranges)])
    turned = turned[np.isfinite(turned[:, 0])]
    assert len(points) == len(turned)
    assert cKDTree(points).query(turned)[0].max() < 1e-5


@pytest.mark.parametrize(
    "content",
    [
        {"z_angles": [0.0], "cartesian": [Path("elsewhere")]},
        {"z_angles": [0.0], "cartesian": [[1.0, 2.0]]},
        {"z_angles": [0.0, 1.0], "cartesian": [np.ones((5, 3))]},
        {"z_angles": [None], "cartesian": [np.ones((5, 3))]},
        {"z_angles": [0.0], "cartesian": [np.array(["a", "b"])]},
        {"z_angles": [0.0], "cartesian": [np.ones(5)]},
        {"cartesian": []},
        ["no", "dictionary"],
    ],
)
def test_a_pickle_that_is_no_raw_scan_of_pilidar_is_refused(tmp_path, content):
    (tmp_path / "scan.pkl").write_bytes(pickle.dumps(content))
    with pytest.raises(FileError, match=r"scan\.pkl"):
        read_sweeps(tmp_path / "scan.pkl", ImportOptions(), ignore)


def test_a_pickle_makes_nothing_but_numbers(tmp_path):
    """A path is refused by its name, whatever it would do."""
    (tmp_path / "scan.pkl").write_bytes(pickle.dumps({"z_angles": Path("elsewhere")}))
    with pytest.raises(FileError, match=r"it holds a pathlib\."):
        read_sweeps(tmp_path / "scan.pkl", ImportOptions(), ignore)


def test_a_frame_that_goes_round_its_axis_gives_the_same_points(tmp_path):
    """The frame that turns is the lidar's own, 5 cm from the axis."""
    image = replace(sweep(), T_scan_axis=None)
    other_scanners.write_laser_scans(tmp_path / "bag", image, lever=True)
    (found,) = read_sweeps(tmp_path / "bag", ImportOptions(Mount(height=0.3)), ignore)
    assert np.allclose(found.T_base_lidar[:2, 3], sweep().T_base_lidar[:2, 3], atol=1e-6)
    assert same_points(found, sweep()) < 1e-4


def test_few_low_points_far_apart_tell_the_height_as_well():
    plain = readings(np.radians(np.arange(-30.0, 30.0)))
    ranges = np.full(len(plain), np.nan)
    ranges[[0, 30]] = 2.0, 3.0
    image = assemble(replace(plain, ranges=ranges), Mount())
    assert estimate_height([image]) == pytest.approx(3.0 * math.sin(1.0))


@pytest.mark.parametrize("quaternion", [0.0, 3.0])
def test_a_transform_that_is_no_rotation_is_left_out(quaternion):
    tree, T = FrameTree(), np.eye(4)
    edge = make_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=quaternion)
    message = typestore().deserialize_cdr(
        other_scanners._edge(0.0, "stand", "laser", T).data, "tf2_msgs/msg/TFMessage"
    )
    message.transforms[0].transform.rotation = edge
    tree.add(message)
    assert tree.samples == {}


def test_a_scan_of_impossible_angles_is_refused(tmp_path):
    image = sweep()
    spec = replace(image.spec, elevations=1e4 * image.spec.elevations)
    other_scanners.write_laser_scans(tmp_path / "bag", replace(image, spec=spec))
    with pytest.raises(FileError, match="a scan from"):
        read_sweeps(tmp_path / "bag", ImportOptions(), ignore)
