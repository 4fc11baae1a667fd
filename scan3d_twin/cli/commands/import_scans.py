"""``twin import``: an aligned model of 2D lines with their angles from scanners of others."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ImportScansOptions:
    """How the readings are to be understood."""

    axis: Literal["yaw", "pitch", "roll"] = "yaw"
    """What the axis does: yaw turns the scan plane about the vertical, pitch tips it about the axis
    to the left, roll about that ahead. Transforms of a ROS 2 recording tell it."""
    mount: Annotated[
        str | None,
        Parameter(allow_leading_hyphen=True, show_default=lambda _: "on the axis"),
    ] = None
    """Lidar at the axis angle 0: x,y,z [m] from the axis, or with yaw,pitch,roll [deg]."""
    height: Annotated[float | None, Parameter(show_default=lambda _: "by the lowest readings")] = (
        None
    )
    """Height of the axis above the floor [m]."""
    topic: str | None = None
    """Topic of the scans in a ROS 2 recording, where there are several."""
    joint: str | None = None
    """Joint of a ROS 2 recording that turns the lidar; else /tf tells."""
    max_range: float | None = None
    """Longest range that is used [m]."""
    model: Literal["everything", "salient"] = "everything"
    """What is modelled: everything within reach, or the thing that stands out."""
    epsilon: float = 10.0
    """Error of a view above which the report warns [mm]."""
    out: Annotated[Path | None, Parameter(show_default=lambda _: "runs/NAME-TIME")] = None
    """New folder for results."""
    json: bool = False
    """Print only the report, as JSON, on standard output."""


def import_scans(
    source: Path,
    /,
    *,
    options: Annotated[ImportScansOptions, Parameter(name="*")] = ImportScansOptions(),
) -> None:
    """Make an aligned model of the sweeps of another scanner.

    A sweep is many 2D lines, each with the angle of the axis that turned the scanner. Files of
    several sweeps, and folders of several files, become several views, which are registered
    without odometry: the scanner may be set down anew within about 1 m and 60 deg. The result is a
    run like any other, for `twin view`, `export`, `mesh` and `compare`.

    Reads CSV, sensor_msgs/LaserScan with /tf or joint states in MCAP files and rosbag2 folders, and
    the raw scans of PiLiDAR.

    Args:
        source: The file or folder.
        options: How the readings are to be understood.
    """
    import sys

    from scan3d_twin.api.imports import import_scans as run
    from scan3d_twin.cli.output import say
    from scan3d_twin.cli.summary import next_steps, summary
    from scan3d_twin.core.config import Config, TargetConfig
    from scan3d_twin.core.planning_config import PlanningConfig
    from scan3d_twin.recording.importing.assemble import Mount
    from scan3d_twin.recording.importing.source import ImportOptions
    from scan3d_twin.run.folder import claim_folder, default_folder, release_folder
    from scan3d_twin.run.report import report_json

    # Check the options
    if options.max_range is not None and not 0 < options.max_range <= 100:
        raise ConfigError(f"--max-range must be > 0 and <= 100 m, got {options.max_range:g}")
    if options.height is not None and not 0 <= options.height <= 100:
        raise ConfigError(f"--height must be >= 0 and <= 100 m, got {options.height:g}")
    mount = Mount(options.axis, height=options.height)
    mount = mount if options.mount is None else mount.parse(options.mount)
    config = Config(
        target=TargetConfig(extraction=options.model),
        planning=PlanningConfig(epsilon=options.epsilon / 1e3),
    )

    # Import into a new folder
    name = source.resolve().stem or "import"
    folder = claim_folder(default_folder(name) if options.out is None else options.out)
    try:
        outcome = run(
            source,
            folder,
            ImportOptions(mount, options.topic, options.joint, options.max_range),
            config,
            say,
        )
    finally:
        release_folder(folder)
    report = outcome.report
    say(report_json(report) if options.json else summary(report, folder), sys.stdout, end="")
    if not options.json:
        say(next_steps(folder))
