"""``twin mesh``: the surface of a run's target as a triangle mesh."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from scan3d_twin.cli.output import say

if TYPE_CHECKING:
    from scan3d_twin.core.model.mesh import Mesh
    from scan3d_twin.core.session import Session

POISSON_VOXEL = 0.005
"""Voxel size at which the views are fused before Poisson [m]: half the wanted accuracy."""


def mesh(
    run: Path,
    /,
    *,
    to: str = "obj",
    method: Literal["grid", "poisson"] = "grid",
    unit: Literal["m", "mm"] = "m",
    out: Annotated[Path | None, Parameter(show_default="mesh.FORMAT in the run's folder")] = None,
    json: bool = False,
) -> None:
    """Write the surface of a run's target as a triangle mesh.

    What was not seen stays open: there are no triangles across missing readings or depth edges.

    Args:
        run: Folder of a run, or its session file.
        to: Format: obj, stl, glb or ply.
        method: grid joins neighbouring readings of each view, and takes the better view where two
            overlap; poisson fits one smooth surface to all views with Open3D.
        unit: Unit of the lengths in the file, where the format leaves it open (glb is in metres):
            printers and CAD take the numbers of STL and OBJ files for millimetres.
        out: File to write.
        json: Print the size of the mesh as JSON.
    """
    from scan3d_twin.core.errors import ScanError
    from scan3d_twin.recording.export import find_mesh_format
    from scan3d_twin.recording.export.format import check_unit
    from scan3d_twin.recording.export.unit import mesh_in_unit
    from scan3d_twin.recording.load import load_session, run_folder
    from scan3d_twin.run.folder import write_file

    kind = find_mesh_format(to)
    check_unit(to, kind, unit)
    surface = _surface(load_session(run).session, method)
    if len(surface.faces) == 0:
        raise ScanError(f"the views in {run} show no surface; nothing is written")
    path = out or run_folder(run) / f"mesh.{to}"
    write_file(path, kind.encode(mesh_in_unit(surface, unit)))
    found = {
        "file": str(path),
        "unit": unit,
        "vertices": len(surface.vertices),
        "triangles": len(surface.faces),
        "area_m2": round(float(surface.areas.sum()), 4),
    }
    if json:
        print(json_module.dumps(found, indent=2))
    else:
        facts = f"{found['triangles']} triangles, {found['area_m2']:.2f} m2, lengths in {unit}"
        say(f"{path}: {facts}", sys.stdout)


def _surface(session: Session, method: str) -> Mesh:
    if method == "poisson":
        from scan3d_twin.core.model.fused_cloud import build_model
        from scan3d_twin.recording.export.meshes import reconstruct_poisson

        return reconstruct_poisson(build_model(session, POISSON_VOXEL))
    from scan3d_twin.core.model.fused_cloud import build_view_clouds
    from scan3d_twin.core.model.mesh import build_mesh

    return build_mesh(session, build_view_clouds(session))
