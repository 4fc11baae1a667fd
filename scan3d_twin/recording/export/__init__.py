"""The one registry of export formats: our own by name, and those of other packages.

Other packages add formats by the entry point group ``scan3d_twin.exporters``: a name, and a
``CloudFormat``, ``MeshFormat`` or ``RecordingFormat`` (docs/extending.md). Importing this package
costs nothing (no numpy), so that ``twin export --help`` can list the formats.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from scan3d_twin.core.errors import UnknownNameError
from scan3d_twin.core.plugins import PluginError, load_plugin

if TYPE_CHECKING:
    from scan3d_twin.recording.export.format import Format, MeshFormat

ENTRY_POINTS = "scan3d_twin.exporters"
"""Entry point group in which other packages offer formats."""

_BUILT_IN = {
    "e57": "e57:E57",
    "glb": "meshes:GLB",
    "las": "las:LAS",
    "laz": "las:LAZ",
    "obj": "meshes:OBJ",
    "pcd": "pcd:PCD",
    "ply": "ply:PLY",
    "rosbag2": "rosbag2:ROSBAG2",
    "rrd": "rrd:RRD",
    "stl": "meshes:STL",
    "uos": "uos:UOS",
    "xyz": "xyz:XYZ",
}
"""Built-in formats by name, loaded on demand: module in this package, and its attribute."""
_BUILT_IN_MESHES = {
    **{name: _BUILT_IN[name] for name in ("glb", "obj", "stl")},
    "ply": "meshes:PLY",
}
"""Our own formats of meshes by name; ``ply`` holds clouds as well."""


def list_formats() -> tuple[str, ...]:
    """Return the names that ``find_format`` knows."""
    return tuple(sorted({*_BUILT_IN, *_find_external()}))


def list_mesh_formats() -> tuple[str, ...]:
    """Return the names that ``find_mesh_format`` knows; what cannot be loaded is left out."""
    return tuple(sorted({*_BUILT_IN_MESHES, *filter(_is_mesh_format, _find_external())}))


def find_format(name: str) -> Format:
    """Return the format called ``name``.

    Raises:
        UnknownNameError: There is none.
        PluginError: The package that offers it cannot be loaded, or what it offers is no format.
    """
    if name in _BUILT_IN:
        return _load_built_in(_BUILT_IN[name])
    others = _find_external()
    if name not in others:
        raise UnknownNameError("format", name, list_formats())
    from scan3d_twin.recording.export.format import CloudFormat, MeshFormat, RecordingFormat

    place = others[name].value
    found = load_plugin("format", name, place)
    if not isinstance(found, CloudFormat | MeshFormat | RecordingFormat):
        reason = f"it is no CloudFormat, MeshFormat or RecordingFormat but {found!r}"
        raise PluginError("format", name, place, reason)
    return found


def find_mesh_format(name: str) -> MeshFormat:
    """Return the format of meshes called ``name``; errors as ``find_format``."""
    from scan3d_twin.recording.export.format import MeshFormat

    if name in _BUILT_IN_MESHES:
        found = _load_built_in(_BUILT_IN_MESHES[name])
    elif name in _find_external():
        found = find_format(name)
    else:
        found = None
    if not isinstance(found, MeshFormat):
        raise UnknownNameError("format of meshes", name, list_mesh_formats())
    return found


def _is_mesh_format(name: str) -> bool:
    from scan3d_twin.recording.export.format import MeshFormat

    try:
        return isinstance(find_format(name), MeshFormat)
    except PluginError:
        return False


def _load_built_in(place: str) -> Format:
    found: Format = resolve_name(f"{__name__}.{place}")
    return found


def _find_external() -> dict[str, EntryPoint]:
    """Return the entry points of other packages by name; they do not replace our own."""
    return {
        point.name: point
        for point in entry_points(group=ENTRY_POINTS)
        if point.name not in _BUILT_IN
    }
