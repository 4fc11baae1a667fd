"""Recorded sessions from Python: read them, and write their models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.session import Session
from scan3d_twin.recording import load
from scan3d_twin.recording.export import find_format
from scan3d_twin.recording.export.clouds import export_cloud, pieces
from scan3d_twin.recording.export.format import CloudFormat, check_unit


def load_session(place: str | Path) -> Session:
    """Return the session that a run has recorded.

    Args:
        place: The run's folder, or its ``session.mcap``. An unfinished recording is read as far as
            it goes.

    Raises:
        FileError: There is none, no view was finished in it, or it is damaged.

    >>> with tempfile.TemporaryDirectory() as folder:
    ...     run = s3d.run_sim("three_boxes", options={"max_views": 2}, out=folder)
    ...     session = s3d.load_session(folder)
    >>> session.views[1].T_world_scan == run.session.views[1].T_world_scan
    True
    """
    return load.load_session(Path(place)).session


def export_model(
    session: Session,
    path: str | Path,
    format: str = "ply",
    *,
    voxel: float = 0.0,
    per_view: bool = False,
    unit: Literal["m", "mm"] = "m",
) -> list[Path]:
    """Write the model of ``session`` for other programs and return the written files.

    Args:
        session: With at least one view.
        path: The file, or the folder of files where each view has its own.
        format: ``ply``, ``pcd``, ``xyz``, ``las``, ``laz``, ``e57`` or ``uos``, or a format of
            clouds of another package.
        voxel: Side of the voxels in which the views are fused [m]; 0 keeps every point.
        per_view: Each view on its own, in its frame ``scan``, instead of one cloud in ``world``.
        unit: Unit of the lengths in the files, where the format leaves it open.

    Raises:
        UnknownNameError: There is no such format.
        ConfigError: It is no format of clouds, its library is missing (the message says what to
            install), it prescribes another unit, or views are to be fused and to stay apart.
        FileError: A file cannot be written.

    >>> with s3d.open_sim("three_boxes", seed=0) as (robot, truth):
    ...     session = s3d.digitize(robot, s3d.Config(max_views=1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [written] = s3d.export_model(session, f"{folder}/model.xyz", "xyz", voxel=0.01)
    >>> written.name
    'model.xyz'
    """
    kind = find_format(format)
    if not isinstance(kind, CloudFormat):
        raise ConfigError(f"{format} is no format of clouds: use twin export or twin mesh")
    if not voxel >= 0:
        raise ConfigError(f"voxel must be >= 0 m, got {voxel:g}")
    check_unit(format, kind, unit)
    parts = pieces(session, per_view=per_view, voxel=voxel, unit=unit)
    return export_cloud(parts, kind, Path(path), per_view=per_view)
