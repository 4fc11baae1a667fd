"""The one registry of export formats: our own by name, and those of other packages.

Other packages add formats by the entry point group ``scan3d_twin.exporters``: a name, and a
``CloudFormat``, ``MeshFormat`` or ``RecordingFormat`` (docs/extending.md). Importing this package
costs nothing (no numpy), so that ``twin export --help`` can list the formats.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from scan3d_twin.core.errors import ConfigError, UnknownNameError

if TYPE_CHECKING:
    from scan3d_twin.recording.export.format import Format, MeshFormat

ENTRY_POINTS = "scan3d_twin.exporters"
"""Entry point group in which other packages offer formats."""

_OWN = {
    "e57": "e57:E57",
    "glb": "meshes:GLB",
    "las": "las:LAS",
    "laz": "las:LAZ",
    "obj": "meshes:OBJ",
    "pcd": "pcd:PCD",
    "ply": "ply:PLY",
    "rosbag2": "rosbag2:ROSBAG2",
    "stl": "meshes:STL",
    "uos": "uos:UOS",
    "xyz": "xyz:XYZ",
}
"""Our own formats by name, loaded when they are wanted: module in this package, and what in it."""
_OWN_MESHES = {**{name: _OWN[name] for name in ("glb", "obj", "stl")}, "ply": "meshes:PLY"}
"""Our own formats of meshes by name; ``ply`` holds clouds as well."""


def format_names() -> tuple[str, ...]:
    """Return the names that ``find_format`` knows."""
    return tuple(sorted({*_OWN, *_others()}))


def mesh_format_names() -> tuple[str, ...]:
    """Return the names that ``find_mesh_format`` knows."""
    from scan3d_twin.recording.export.format import MeshFormat

    others = (name for name in _others() if isinstance(find_format(name), MeshFormat))
    return tuple(sorted({*_OWN_MESHES, *others}))


def find_format(name: str) -> Format:
    """Return the format called ``name``.

    Raises:
        UnknownNameError: There is none.
        ConfigError: The package that offers it cannot be loaded.
    """
    if name in _OWN:
        return _own(_OWN[name])
    others = _others()
    if name not in others:
        raise UnknownNameError("format", name, format_names())
    try:
        found: Format = others[name].load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(
            f"format {name} ({others[name].value}) cannot be loaded: {error}"
        ) from None
    return found


def find_mesh_format(name: str) -> MeshFormat:
    """Return the format of meshes called ``name``; errors as ``find_format``."""
    from scan3d_twin.recording.export.format import MeshFormat

    if name not in mesh_format_names():
        raise UnknownNameError("format of meshes", name, mesh_format_names())
    found = _own(_OWN_MESHES[name]) if name in _OWN_MESHES else find_format(name)
    assert isinstance(found, MeshFormat)
    return found


def _own(place: str) -> Format:
    found: Format = resolve_name(f"{__name__}.{place}")
    return found


def _others() -> dict[str, EntryPoint]:
    """Return the entry points of other packages by name; they do not replace our own."""
    return {
        point.name: point for point in entry_points(group=ENTRY_POINTS) if point.name not in _OWN
    }
