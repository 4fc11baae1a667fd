"""The inputs of benchmarks/fuzz.py for ``twin import``: sweeps of scanners that are not ours."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

BAG = "bag.mcap"
"""LaserScan and transforms, as a file of rosbag2."""
SOURCES = {"readings": "readings.csv", "lines": "lines.csv", "pilidar": "scan_lidar.pkl",
           "laserscan": BAG}  # fmt: skip
"""Right files by the name of their kind."""


def write_imports(folder: Path) -> None:
    """Write a right file of each kind into ``folder``: a sweep of 40 lines."""
    import other_scanners
    import synthetic

    from scan3d_twin.core.types import Pose2, read_only

    lidar = synthetic.spec(85)
    lidar = replace(lidar, elevations=read_only(8.0 * lidar.elevations), max_range=4.1)
    seen = synthetic.observe(
        Pose2(-0.3, 0.2, 0.4), width=math.radians(120), step=math.radians(3.0), lidar=lidar
    )
    image = other_scanners.turn_like_a_robot(seen.image)
    other_scanners.write_readings(folder / SOURCES["readings"], image)
    other_scanners.write_lines(folder / SOURCES["lines"], image)
    other_scanners.write_pilidar(folder / SOURCES["pilidar"], image)
    other_scanners.write_laser_scans(folder / "bag", image)
    (found,) = (folder / "bag").glob("*.mcap")
    (folder / BAG).write_bytes(found.read_bytes())


def make_laser_scans(base: Path, draw: Random, folder: Path) -> Path:
    """Change messages of a bag, written anew with right checksums, or its bytes."""
    from fuzz_inputs import change_bytes
    from mcap.reader import make_reader
    from mcap.writer import Writer

    path = folder / BAG
    if draw.random() < 0.3:
        path.write_bytes(change_bytes((base / BAG).read_bytes(), draw))
        return path
    with (base / BAG).open("rb") as right, path.open("wb") as file:
        rows = list(make_reader(right).iter_messages())
        changed = {draw.randrange(len(rows)) for _ in range(draw.choice((1, 2, 20)))}
        writer, ids = Writer(file), dict[int, int]()
        writer.start()
        for k, (schema, channel, message) in enumerate(rows):
            if channel.id not in ids:
                ids[channel.id] = _copy_channel(writer, schema, channel)
            data = change_bytes(message.data, draw) if k in changed else message.data
            writer.add_message(ids[channel.id], message.log_time, data, message.publish_time)
        writer.finish()
    return path


def _copy_channel(writer: Any, schema: Any, channel: Any) -> int:
    number = writer.register_schema(schema.name, schema.encoding, schema.data)
    return int(
        writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata)
    )


def read_import(path: Path) -> None:
    """Read the sweeps of a file and compute their points."""
    from scan3d_twin.recording.importing.source import ImportOptions, read_sweeps

    for image in read_sweeps(path, ImportOptions(), lambda _: None):
        _ = image.points
