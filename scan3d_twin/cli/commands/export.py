"""``twin export``: the model of a run for other programs."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def export(
    run: Path,
    /,
    *,
    to: str,
    per_view: bool = False,
    voxel: float = 0.0,
    out: Annotated[Path | None, Parameter(show_default="in the run's folder")] = None,
    json: bool = False,
) -> None:
    """Write the model of a run for other programs; meshes as `twin mesh` makes them.

    Args:
        run: Folder of a run, or its session file.
        to: Format: ply, pcd, xyz, las, laz, e57 or uos (3DTK) for points; obj, stl or glb for a
            mesh; rosbag2 for all that was recorded.
        per_view: Keep the views apart, each in its own frame, with their poses.
        voxel: Voxel size at which the views are fused, weighted by their uncertainty [mm]; 0 keeps
            all points.
        out: File or folder to write.
        json: Print the paths of the files as JSON.
    """
    from scan3d_twin.core.errors import ConfigError, UnknownNameError
    from scan3d_twin.recording.export import CLOUDS
    from scan3d_twin.recording.export.meshes import MESH_FORMATS

    known = {*CLOUDS, *MESH_FORMATS, "rosbag2"}
    if to not in known:
        raise UnknownNameError("format", to, known)
    if not voxel >= 0:
        raise ConfigError(f"--voxel must be >= 0 mm, got {voxel:g}")
    if (per_view or voxel) and to not in CLOUDS:
        raise ConfigError(f"--per-view and --voxel are for point clouds; {to} is none")
    if to == "rosbag2":
        files = _bag(run, out)
    elif to in CLOUDS:
        files = _cloud(run, to, out, per_view=per_view, voxel=voxel / 1e3)
    else:
        from scan3d_twin.cli.commands.mesh import mesh

        mesh(run, to=to, out=out, json=json)
        return
    if json:
        print(json_module.dumps({"format": to, "files": [str(path) for path in files]}, indent=2))
    else:
        print("\n".join(str(path) for path in files))


def folder_of(run: Path) -> Path:
    """Return the folder of a run that is named by its folder or its session file."""
    return run if run.is_dir() else run.parent


def _cloud(run: Path, name: str, out: Path | None, *, per_view: bool, voxel: float) -> list[Path]:
    from scan3d_twin.recording.export import export_cloud, file_name, pieces
    from scan3d_twin.recording.load import load_session

    session = load_session(run).session
    path = out or folder_of(run) / file_name(name, per_view=per_view)
    parts = pieces(session, per_view=per_view, voxel=voxel)
    return export_cloud(parts, name, path, per_view=per_view)


def _bag(run: Path, out: Path | None) -> list[Path]:
    from scan3d_twin.recording.export import rosbag2
    from scan3d_twin.recording.load import find_session_file

    path = out or folder_of(run) / "rosbag2"
    rosbag2.write(find_session_file(run), path)
    return [path]
