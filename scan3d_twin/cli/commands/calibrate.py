"""``twin calibrate lidar``: estimate the lidar's extrinsics from scans."""

from __future__ import annotations

import json as json_module
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from scan3d_twin.core.config import MountConfig
    from scan3d_twin.core.scanning.extrinsic_calibration import Calibration

_UNITS = {
    "lateral": (1e3, "mm", "to the left of its nominal place"),
    "roll": (math.degrees(1.0), "deg", "leaning to its right"),
    "pitch": (math.degrees(1.0), "deg", "looking down"),
    "yaw_scale": (1e2, "%", "turned further than the odometry says"),
    "time_offset": (1e3, "ms", "measured later than stamped"),
}
_CURES = {
    "yaw_scale": "scan a full turn: twin scan --width 360",
    "time_offset": "scan in both directions: twin scan --width 300 --back",
}
"""Which scans make a value observable."""


def calibrate(what: Literal["lidar"], folder: Path, /, *, json: bool = False) -> None:
    """Estimate the lidar's extrinsics from scans: offset, tilt, yaw scale and time offset.

    Scans from more places make it more accurate. Range errors of single materials are not
    estimated.

    Args:
        what: What to calibrate: the lidar's extrinsics.
        folder: Folder of a run, or of scans of a room: `twin scan --width 360 --out cal/turn`, and
            for the time offset `twin scan --width 300 --back --out cal/back`.
        json: Print one line of JSON.

    Raises:
        FileError: There is no scan in it.
        RegistrationError: The scans show no walls.
    """
    from scan3d_twin.core.scanning import extrinsic_calibration as self_calibration
    from scan3d_twin.core.scanning.extrinsics import compose_mounts
    from scan3d_twin.recording.scans import read_places

    found = self_calibration.calibrate(read_places(folder))
    mount = compose_mounts(_taken_with(folder), found.mount)
    if json:
        print(json_module.dumps(_document(mount, found)))
    else:
        print("\n".join(_lines(mount, found)))


def _taken_with(folder: Path) -> MountConfig:
    """Return the extrinsics that the run in ``folder`` was corrected by; all 0 for scans."""
    from scan3d_twin.core.config import MountConfig
    from scan3d_twin.core.errors import FileError
    from scan3d_twin.recording.load import load_session
    from scan3d_twin.run.settings import build_settings, read_settings

    try:
        return load_session(folder).session.config.mount
    except FileError:
        path = folder / "config.toml"
    return build_settings([read_settings(path)]).config.mount if path.exists() else MountConfig()


def _estimated(mount: MountConfig) -> dict[str, float]:
    """Return the values of ``mount`` that a calibration estimates, by name."""
    return {name: value for name, value in asdict(mount).items() if name in _UNITS}


def _document(mount: MountConfig, found: Calibration) -> dict[str, object]:
    values = _estimated(mount)
    return {
        "mount": values,
        "standard_errors": dict(zip(values, found.sigmas.tolist(), strict=True)),
        "known": dict(zip(values, found.known, strict=True)),
        "planes": found.planes,
        "readings": found.readings,
        "flatness_m": found.flatness,
    }


def _lines(mount: MountConfig, found: Calibration) -> Iterator[str]:
    values = _estimated(mount)
    yield (
        f"{found.planes} planes, {found.readings} readings on them, flat to "
        f"{1e3 * found.flatness:.1f} mm"
    )
    for (name, value), sigma, known in zip(values.items(), found.sigmas, found.known, strict=True):
        factor, unit, words = _UNITS[name]
        if known:
            yield f"{name:12s} {factor * value:+8.2f} +- {factor * sigma:.2f} {unit:4s} {words}"
        else:
            yield f"{name:12s} unknown: {_CURES.get(name, 'scan from more places')}"
    yield "for a --config FILE:\n[mount]"
    for (name, value), known in zip(values.items(), found.known, strict=True):
        if known:
            yield f"{name} = {value:.6f}"
