"""``twin export``: the model of a run for other programs."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.cli.output import say
from scan3d_twin.recording.export import list_formats

if TYPE_CHECKING:
    from scan3d_twin.recording.export.format import CloudFormat, RecordingFormat
    from scan3d_twin.recording.export.unit import Unit


def export(
    run: Path,
    /,
    *,
    to: Annotated[str, Parameter(help=f"Format: {', '.join(list_formats())}.")],
    per_view: bool = False,
    voxel: float = 0.0,
    unit: Literal["m", "mm"] = "m",
    out: Annotated[Path | None, Parameter(show_default="in the run's folder")] = None,
    json: bool = False,
) -> None:
    """Write the model of a run for other programs.

    Point clouds: ply, pcd, xyz, las, laz, e57 or uos (3DTK); meshes: obj, stl or glb, as
    `twin mesh` makes them; rosbag2 (ROS 2, Foxglove) and rrd (rerun): what was recorded. Other
    packages may add formats (docs/extending.md).

    Args:
        run: The run's folder, or its session file.
        to: Format; the help lists those that are installed.
        per_view: Keep the views apart, each in its own frame, with their poses.
        voxel: Voxel size at which the views are fused, weighted by their uncertainty [mm]; 0 keeps
            all points.
        unit: Unit of the lengths in the file, where the format leaves it open: printers and CAD
            take the numbers of STL and OBJ files for millimetres.
        out: File or folder to write.
        json: Print the paths of the files as JSON.
    """
    from scan3d_twin.core.errors import ConfigError
    from scan3d_twin.recording.export import find_format
    from scan3d_twin.recording.export.format import CloudFormat, MeshFormat, check_unit

    # Refuse what the format cannot do
    kind = find_format(to)
    if not voxel >= 0:
        raise ConfigError(f"--voxel must be >= 0 mm, got {voxel:g}")
    if (per_view or voxel) and not isinstance(kind, CloudFormat):
        raise ConfigError(f"--per-view and --voxel are for point clouds; {to} is none")
    check_unit(to, kind, unit)

    # Write it
    if isinstance(kind, MeshFormat):
        from scan3d_twin.cli.commands.mesh import mesh

        mesh(run, to=to, unit=unit, out=out, json=json)
        return
    if isinstance(kind, CloudFormat):
        files = _cloud(run, to, kind, out, per_view=per_view, voxel=voxel / 1e3, unit=unit)
    else:
        files = _recording(run, to, kind, out)
    if json:
        told = {"format": to, "unit": unit, "files": [str(path) for path in files]}
        print(json_module.dumps(told, indent=2))
    else:
        say("\n".join(str(path) for path in files), sys.stdout)


def _cloud(
    run: Path,
    name: str,
    kind: CloudFormat,
    out: Path | None,
    *,
    per_view: bool,
    voxel: float,
    unit: Unit,
) -> list[Path]:
    from scan3d_twin.recording.export.clouds import export_cloud, file_name, pieces
    from scan3d_twin.recording.load import load_session, run_folder
    from scan3d_twin.run.folder import require_own_folders

    session, folder = load_session(run).session, run_folder(run)
    path = out or folder / file_name(name, kind, per_view=per_view)
    if out is None and path.is_dir():  # not through a link in a run that came from someone else
        require_own_folders(folder, path)
    parts = pieces(session, per_view=per_view, voxel=voxel, unit=unit)
    return export_cloud(parts, kind, path, per_view=per_view)


def _recording(run: Path, name: str, kind: RecordingFormat, out: Path | None) -> list[Path]:
    from scan3d_twin.recording.load import find_session_file, run_folder

    path = out or run_folder(run) / (f"session{kind.suffix}" if kind.suffix else name)
    kind.write(find_session_file(run), path)
    return [path]
