"""``twin scan``: one 3D image from where the robot stands; it turns, but drives nowhere."""

from __future__ import annotations

import json as json_module
import math
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from scan3d_twin.cli.options import PortOptions, TurntableOptions, choose_base, env
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.devices.registry import DEFAULT_BASE, DEFAULT_LIDAR, Devices

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from scan3d_twin.core.hal import Robot
    from scan3d_twin.core.types import Observation


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
    out: Annotated[Path | None, env("OUT", "runs/scan-TIME")] = None
    """Folder for the results, new or empty."""
    json: bool = False
    """Print one line of JSON."""


def scan(*, options: Annotated[OneScanOptions, Parameter(name="*")] = OneScanOptions()) -> None:
    """Take one 3D image from where the robot stands.

    The robot turns on the spot, or its turntable turns the lidar, and writes scan.ply, the points
    in the frame of the sweep, and scan.npz, the raw range image; with --back also scan_back.npz.

    Raises:
        TwinError: The image could not be taken; the robot is stopped.
    """
    from scan3d_twin.core.config import Config, SweepConfig
    from scan3d_twin.core.scanning.sweep import sweep
    from scan3d_twin.run.folder import claim_folder, find_free_folder, release_folder

    if options.back and options.width >= 350.0:
        raise ConfigError(f"--back needs --width below 350 deg, got {options.width:g}")
    base = choose_base(options.robot, options.base)
    devices = Devices(
        base or DEFAULT_BASE,
        options.lidar or DEFAULT_LIDAR,
        options.lidar_link or "",
        is_base_stated=base is not None,
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
            observations = [
                sweep(robot, 0.0, replace(Config(), sweep=wanted), lambda line: None)
                for _ in range(2 if options.back else 1)
            ]
        _save(observations, folder, as_json=options.json)
    finally:
        release_folder(folder)


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
