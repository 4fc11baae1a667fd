"""The model in the formats of other programs: one fused cloud, or view by view with poses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scan3d_twin.core.errors import ConfigError, FileError, ScanError
from scan3d_twin.core.model.fused_cloud import Model, build_model, build_view_cloud
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.export.format import CloudFormat
from scan3d_twin.recording.export.piece import Piece, poses_csv
from scan3d_twin.recording.export.unit import Unit
from scan3d_twin.run.folder import release_folder, write_file


def pieces(session: Session, *, per_view: bool, voxel: float, unit: Unit = "m") -> list[Piece]:
    """Return the model as one piece in ``world``, or one for each view in its frame ``scan``.

    Their lengths are in ``unit``.

    Raises:
        ConfigError: Views are to be fused in voxels of side ``voxel`` [m] and to stay apart.
        ScanError: No view has a point.
    """
    parts = _pieces_in_metres(session, per_view=per_view, voxel=voxel)
    if not any(len(part.model) for part in parts):
        raise ScanError("the views show no point of the target; nothing is written")
    return [part if unit == part.unit else part.in_unit(unit) for part in parts]


def _pieces_in_metres(session: Session, *, per_view: bool, voxel: float) -> list[Piece]:
    if not per_view:
        return [Piece("cloud", build_model(session, voxel), Pose2())]
    if voxel:
        raise ConfigError("--voxel fuses the views and --per-view keeps them apart; give one")
    result = []
    for index, view in enumerate(session.views):
        model = build_view_cloud(view, index).cleaned
        result.append(
            Piece(f"view_{index:03d}", _in_scan(model, view.T_world_scan), view.T_world_scan)
        )
    return result


def _in_scan(model: Model, T_world_scan: Pose2) -> Model:
    back = T_world_scan.inverse()
    return Model(back.apply(model.points), back.rotate(model.normals), model.sigma, model.view)


def file_name(name: str, kind: CloudFormat, *, per_view: bool) -> str:
    """Return what the file or folder in the format called ``name`` is called by default."""
    if kind.folder or (per_view and kind.write is None):
        return f"{name}_views" if per_view else name
    return f"views{kind.suffix}" if per_view else f"cloud{kind.suffix}"


def export_cloud(
    parts: Sequence[Piece], kind: CloudFormat, path: Path, *, per_view: bool
) -> list[Path]:
    """Write ``parts`` in the format ``kind`` to the file or folder ``path``; return the files.

    A folder of views holds ``poses.csv`` with each view's pose in ``world`` too.

    Raises:
        ConfigError: Its library is missing; the message says what to install.
        FileError: A file cannot be written; an empty folder is not left.
    """
    try:
        return _write_files(parts, kind, path, per_view=per_view)
    except FileError:
        release_folder(path)
        raise


def _write_files(
    parts: Sequence[Piece], kind: CloudFormat, path: Path, *, per_view: bool
) -> list[Path]:
    if kind.write is not None:
        return kind.write(parts, path)
    assert kind.encode is not None
    if not per_view:
        write_file(path, kind.encode(parts[0]))
        return [path]
    written = []
    for part in parts:
        written.append(path / (part.name + kind.suffix))
        write_file(written[-1], kind.encode(part))
    written.append(path / "poses.csv")
    write_file(written[-1], poses_csv(parts))
    return written
