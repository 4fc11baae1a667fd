"""``twin calibrate lidar``: estimate the lidar's extrinsics from scans."""

from __future__ import annotations

import json as json_module
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from scan3d_twin.core.config import MountConfig
    from scan3d_twin.core.scanning.calibration.lidar_mount import Calibration

_UNITS = {
    "lateral": (1e3, "mm", "to the left of its nominal place"),
    "roll": (math.degrees(1.0), "deg", "leaning to its right"),
    "pitch": (math.degrees(1.0), "deg", "looking down"),
    "yaw_scale": (1e2, "%", "turned further than the odometry says"),
    "time_offset": (1e3, "ms", "measured later than stamped"),
    "yaw": (math.degrees(1.0), "deg", "turned to its left"),
    "play": (math.degrees(1.0), "deg", "more play of the turntable than its nominal one"),
    "axis_roll": (math.degrees(1.0), "deg", "axis leaning to the right, against the floor"),
    "axis_pitch": (math.degrees(1.0), "deg", "axis tipped forwards, against the floor"),
}
_BOTH_RATES = (
    "scan in both directions at two rates: twin scan --width 300 --back, with --rate 5 "
    "and with --rate 15"
)
_CURES = {
    "yaw_scale": "scan a full turn: twin scan --width 360",
    "time_offset": "scan in both directions: twin scan --width 300 --back",
    "play": _BOTH_RATES,
    "axis_roll": "scan where the floor is seen all round",
    "axis_pitch": "scan where the floor is seen all round",
}
"""Which scans make a value observable."""


def calibrate(what: Literal["lidar"], folder: Path, /, *, json: bool = False) -> None:
    """Estimate the lidar's extrinsics from scans: offset, tilt, yaw scale and time offset.

    Scans from more places make it more accurate. Of a turntable, its play and the lean of its axis
    against the floor are found too. What the scans cannot show is named, and how to show it.

    Args:
        what: What to calibrate: the lidar's extrinsics.
        folder: Folder of a run, or of scans of a room: `twin scan --width 360 --out cal/turn`, and
            for the time offset `twin scan --width 300 --back --out cal/back`; with a turntable
            once more with `--rate 15 --out cal/fast`.
        json: Print one line of JSON.

    Raises:
        FileError: There is no scan in it.
        RegistrationError: The scans show no walls.
    """
    from scan3d_twin.core.scanning.calibration import lidar_mount as self_calibration
    from scan3d_twin.core.scanning.calibration.extrinsics import compose_mounts
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


def _document(mount: MountConfig, found: Calibration) -> dict[str, object]:
    errors = zip(found.names, found.sigmas.tolist(), strict=True)
    return {
        "mount": {name: getattr(mount, name) for name in found.names},
        "standard_errors": {name: e if math.isfinite(e) else None for name, e in errors},
        "known": dict(zip(found.names, found.known, strict=True)),
        "planes": found.planes,
        "readings": found.readings,
        "flatness_m": found.flatness,
    }


def _lines(mount: MountConfig, found: Calibration) -> Iterator[str]:
    yield (
        f"{found.planes} planes, {found.readings} readings on them, flat to "
        f"{1e3 * found.flatness:.1f} mm"
    )
    for name, sigma, known in zip(found.names, found.sigmas, found.known, strict=True):
        factor, unit, words = _UNITS[name]
        if known:
            value = factor * getattr(mount, name)
            yield f"{name:12s} {value:+8.2f} +- {factor * sigma:.2f} {unit:4s} {words}"
        else:
            yield f"{name:12s} unknown: {_find_cure(name, found)} (+- inf {unit})"
    yield "for a --config FILE:\n[mount]"
    for name, known in zip(found.names, found.known, strict=True):
        if known:
            yield f"{name} = {getattr(mount, name):.6f}"


def _find_cure(name: str, found: Calibration) -> str:
    """Return what would make the parameter ``name`` observable, or why nothing can."""
    if name == found.turned_about:
        held = f", so {found.same_as} holds both" if found.same_as else ": that is the heading"
        return (
            f"unobservable, as it turns the lidar about the axis like the zero of the angle{held}"
        )
    if name == "time_offset" and "play" in found.names:
        return _BOTH_RATES
    return _CURES.get(name, "scan from more places")
