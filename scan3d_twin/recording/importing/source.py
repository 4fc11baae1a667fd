"""The sweeps in a file or folder of another scanner, whatever its format."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.scanning.patterns import AXIS_HEIGHT
from scan3d_twin.core.types import RangeImage
from scan3d_twin.recording.importing.assemble import Mount, assemble, estimate_height, lift
from scan3d_twin.recording.importing.csv_file import read_csv
from scan3d_twin.recording.importing.laser_scans import read_laser_scans
from scan3d_twin.recording.importing.pilidar import SUFFIX as PILIDAR
from scan3d_twin.recording.importing.pilidar import read_pilidar
from scan3d_twin.recording.importing.readings import Readings, split_sweeps
from scan3d_twin.recording.importing.ros_log import DATABASE, MCAP, is_rosbag2

TEXT_SUFFIXES, LOG_SUFFIXES = (".csv", ".tsv", ".txt"), (MCAP, DATABASE)
"""Suffixes of CSV files and of ROS 2 recordings."""
SUFFIXES = (*TEXT_SUFFIXES, *LOG_SUFFIXES, PILIDAR)
"""Files that are read."""
MAX_FILES = 1000
"""Most files of a folder."""
CLOUDS = (".ply", ".pcd", ".e57", ".las", ".laz", ".xyz", ".pts", ".ptx", ".obj", ".stl")
"""Files of points, which no longer say how they were measured."""


@dataclass(frozen=True)
class ImportOptions:
    """How the readings are to be understood.

    Attributes:
        mount: The lidar on the turning axis.
        topic: Topic of the scans in a ROS 2 recording; None for the only one.
        joint: Joint that turns the lidar in a ROS 2 recording; None for what turns most.
        max_range: Longest range that is used [m]; None for all.
    """

    mount: Mount = Mount()  # noqa: RUF009 - a frozen value
    topic: str | None = None
    joint: str | None = None
    max_range: float | None = None


def read_sweeps(
    place: Path, options: ImportOptions, notify: Callable[[str], None]
) -> list[RangeImage]:
    """Return the sweeps in the file or folder ``place``, in order, as range images.

    Files of a folder are read in the order of their names, numbers by size.

    Args:
        place: A file of ``SUFFIXES``, a rosbag2 folder, or a folder of files.
        options: How they are to be understood.
        notify: Is told what was assumed.

    Raises:
        FileError: There are none, or a file cannot be read.
    """
    # Read all files
    sweeps: list[Readings] = []
    for path in _list_files(place):
        for readings in _read(path, options):
            sweeps += split_sweeps(readings)
    if options.max_range is not None:
        sweeps = [_limit(each, options.max_range) for each in sweeps]
    images = [assemble(each, options.mount) for each in sweeps]

    # Put the axis at its height above the floor
    if options.mount.height is not None:
        return images
    height = estimate_height(images)
    if height is None:
        height = AXIS_HEIGHT
        notify(f"the axis is assumed {height:.2f} m above the floor; --height states it")
    else:
        notify(f"the axis is {height:.2f} m above the floor, by the lowest readings")
    return [lift(image, height) for image in images]


def _list_files(place: Path) -> list[Path]:
    """Return the files, or rosbag2 folders, at ``place``."""
    if place.is_file() or is_rosbag2(place):
        return [place]
    if not place.is_dir():
        raise FileError(f"there is no {place}")
    found = [p for p in place.iterdir() if is_rosbag2(p) or p.suffix.lower() in SUFFIXES]
    if not found:
        raise FileError(
            f"{place} holds no sweeps: no {', '.join(SUFFIXES)} file and no rosbag2 folder"
        )
    if len(found) > MAX_FILES:
        raise FileError(f"{place} holds {len(found)} files, more than {MAX_FILES}")
    return sorted(found, key=_natural)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    """Return a key by which scan2 comes before scan10."""
    parts = re.split(r"(\d+)", path.name)
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in parts]


def _read(path: Path, options: ImportOptions) -> list[Readings]:
    """Return the readings of one file."""
    suffix = path.suffix.lower()
    if path.is_dir() or suffix in LOG_SUFFIXES:
        return read_laser_scans(path, options.topic, options.joint)
    if suffix in TEXT_SUFFIXES:
        return read_csv(path)
    if suffix == PILIDAR:
        return read_pilidar(path)
    if suffix in CLOUDS:
        raise FileError(
            f"{path} holds points; lines with their angles are needed: {', '.join(SUFFIXES)}"
        )
    if suffix == ".bag":
        raise FileError(
            f"{path} is a recording of ROS 1; convert it with "
            "`rosbags-convert --src FILE.bag --dst FOLDER`"
        )
    raise FileError(f"{path} is of no known type; files that are read: {', '.join(SUFFIXES)}")


def _limit(readings: Readings, max_range: float) -> Readings:
    """Return ``readings`` without ranges beyond ``max_range`` [m]."""
    with np.errstate(invalid="ignore"):
        ranges = np.where(readings.ranges > max_range, np.nan, readings.ranges)
    return replace(readings, ranges=ranges, max_range=max_range)
