"""``twin scan``: one 3D image from where the robot stands; it turns, but drives nowhere."""

from __future__ import annotations

import json as json_module
import math
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.options import PortOptions, TurntableOptions, env
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR, Devices

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from scan3d_twin.core.hal import Robot
    from scan3d_twin.core.types import Observation, Pose2


@dataclass(frozen=True, kw_only=True)
class OneScanOptions(TurntableOptions, PortOptions):
    """What is scanned, and how finely."""

    scene: Annotated[str | None, env("SCENE", "none, the real robot")] = None
    """Scene of the twin (`twin scenes`) in which to scan."""
    width: float = 60.0
    """Horizontal angle of the image, centred on the robot's heading [deg]."""
    rate: float = 5.0
    """Speed of the turn [deg/s]; 5 deg/s at 10 Hz puts the lines 0.5 deg apart."""
    lidar_link: Annotated[str | None, env("LIDAR_LINK", "{twin.lidar_link}")] = None
    """Link of the lidar; of urg04lx: usb (682 steps, 10 Hz), 115200 (357 steps, 10 Hz) or
    115200-full (682 steps, 5 Hz)."""
    back: bool = False
    """Sweep back in the other direction too, for `twin calibrate lidar`; needs a width below
    350 deg."""
    seed: int = 0
    """Seed of the twin's errors and noise."""
    add: Path | None = None
    """Run to which the image is added as a view: set the scanner down within about 1 m and 60 deg
    of an earlier place."""
    place: Annotated[
        str | None, Parameter(allow_leading_hyphen=True, show_default=lambda _: "drawn")
    ] = None
    """With --add in the twin: x,y,yaw [m, deg] of the stand from its first place."""
    out: Annotated[Path | None, env("OUT", "runs/scan-TIME")] = None
    """Folder for the results, new or empty."""
    json: bool = False
    """Print one line of JSON."""


def scan(*, options: Annotated[OneScanOptions, Parameter(name="*")] = OneScanOptions()) -> None:
    """Take one 3D image from where the robot stands.

    The robot turns on the spot, or its turntable turns the lidar, and writes scan.ply, the points
    in the frame of the sweep, and scan.npz, the raw range image; with --back also scan_back.npz.
    With --add the image becomes a view of an earlier run, registered without odometry, and report
    and pictures are renewed.

    Raises:
        TwinError: The image could not be taken; the robot is stopped.
    """
    from scan3d_twin.core.config import Config, SweepConfig
    from scan3d_twin.core.scanning.sweep import sweep
    from scan3d_twin.run.folder import claim_folder, find_free_folder, release_folder

    if options.add is not None:
        _add(options, options.add)
        return
    if options.place is not None:
        raise ConfigError("--place is for --add RUN in the twin")
    if options.back and options.width >= 350.0:
        raise ConfigError(f"--back needs --width below 350 deg, got {options.width:g}")
    devices = Devices(
        options.robot or DEFAULT_BASE,
        options.lidar or DEFAULT_LIDAR,
        options.lidar_link or "",
        is_base_stated=options.robot is not None,
    )
    if options.scene and (options.port or options.lidar_port):
        raise ConfigError("--scene is for the twin, --port and --lidar-port for the real robot")
    wanted = SweepConfig(
        width=math.radians(options.width), margin=0.0, yaw_rate=math.radians(options.rate)
    )
    default = Path("runs") / f"scan-{datetime.now():%Y%m%d-%H%M%S}"
    folder = claim_folder(find_free_folder(default) if options.out is None else options.out)
    try:
        with _opening(options, devices) as (robot, _):
            config = replace(Config(), sweep=wanted)
            observations = [
                sweep(robot, 0.0, config, lambda line: None, rightwards=rightwards)
                for rightwards in ((True, False) if options.back else (None,))
            ]
        _save(observations, folder, as_json=options.json)
    finally:
        release_folder(folder)


def _add(options: OneScanOptions, run: Path) -> None:
    """Add a view to ``run`` and print the new report."""
    import sys

    from scan3d_twin.api.add_view import add_view
    from scan3d_twin.cli.commands.real import open_robot
    from scan3d_twin.cli.output import say
    from scan3d_twin.cli.summary import summary
    from scan3d_twin.recording.load import load_session, run_folder
    from scan3d_twin.run.report import report_json

    # Check the options
    default = OneScanOptions()
    for name in ("scene", "pattern", "turntable", "width", "rate", "back", "seed", "out"):
        if getattr(options, name) != getattr(default, name):
            raise ConfigError(f"--add takes {name} from the run; leave out --{name}")
    place = None if options.place is None else _parse_place(options.place)

    # Take the view and add it
    folder = run_folder(run)
    twin = load_session(folder).settings.twin
    devices = Devices(
        options.robot or twin.robot,
        options.lidar or twin.lidar_model,
        options.lidar_link or twin.lidar_link,
        is_base_stated=options.robot is not None,
    )
    table = None if twin.pattern == "yaw-base" else twin.turntable
    carried = replace(options, pattern=twin.pattern, turntable=table)
    added = add_view(folder, place, lambda: open_robot(carried, devices), say)
    shown = report_json(added.report) if options.json else summary(added.report, folder)
    say(shown, sys.stdout, end="")


def _parse_place(text: str) -> Pose2:
    """Return the place that ``text`` states as x,y,yaw in metres and degrees."""
    from scan3d_twin.core.types import Pose2

    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        x = y = yaw = math.nan
    if not (abs(x) < 1e3 and abs(y) < 1e3 and math.isfinite(yaw)):
        raise ConfigError(f"--place must be x,y,yaw in metres and degrees, got {text!r}")
    return Pose2(x, y, math.radians(yaw))


def _opening(
    options: OneScanOptions, devices: Devices
) -> AbstractContextManager[tuple[Robot, object]]:
    from scan3d_twin.cli.commands.real import choose_turning, open_robot

    if options.scene is None:
        return open_robot(options, devices)
    from scan3d_twin.sim.config import DEFAULT_WORLD, TwinConfig
    from scan3d_twin.sim.robot import open_sim

    config = TwinConfig.of(DEFAULT_WORLD, devices.base, devices.lidar, devices.link)
    turning = choose_turning(options)
    config = replace(config, pattern=turning.pattern, turntable=turning.turntable)
    return open_sim(options.scene, options.seed, config)


def _save(observations: list[Observation], folder: Path, *, as_json: bool) -> None:
    import numpy as np

    from scan3d_twin.recording.image import image_bytes
    from scan3d_twin.recording.ply import ply_bytes
    from scan3d_twin.recording.scans import BACK_SCAN_FILE, SCAN_FILE
    from scan3d_twin.run.folder import write_file

    image = observations[0].image
    points = image.points[np.isfinite(image.ranges)]
    write_file(folder / "scan.ply", ply_bytes(points, np.zeros(len(points), np.int64)))
    names = (SCAN_FILE, BACK_SCAN_FILE)[: len(observations)]
    for name, observation in zip(names, observations, strict=True):
        write_file(folder / name, image_bytes(observation))
    if as_json:
        print(json_module.dumps({"lines": image.n_lines, "points": len(points)}))
    else:
        print(f"{image.n_lines} lines, {len(points)} points")
        print(f"{folder}: scan.ply {' '.join(names)}")
