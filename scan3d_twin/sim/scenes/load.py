"""Loading scenes: those that come with the package, random ones, and files of any place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import ConfigError, SceneError, UnknownNameError
from scan3d_twin.sim.resources import find_resource_dir
from scan3d_twin.sim.room import DEFAULT_ROOM, parse_room
from scan3d_twin.sim.scenes.meshes import MESH_SUFFIXES, mesh_spec
from scan3d_twin.sim.scenes.random_scenes import NAME_PREFIX, scene_of_seed
from scan3d_twin.sim.scenes.scene import Scene, one_line, scene_from_spec
from scan3d_twin.sim.scenes.trial import check_size, limited_memory, try_mjcf


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the package, sorted.

    >>> "sine_box" in s3d.scene_names()
    True
    """
    return tuple(sorted(path.stem for path in find_resource_dir("scenes").glob("*.xml")))


def load_scene(name_or_path: str, mesh_scale: float = 1.0, room: str = DEFAULT_ROOM) -> Scene:
    """Return a built-in scene by name, or an MJCF or mesh file by path.

    Args:
        name_or_path: A name of ``scene_names()``, ``random:SEED``, or a path that ends in .xml .stl
            .ply .obj .glb.
        mesh_scale: Metres per unit of a mesh file.
        room: Room around a mesh: width by depth, such as ``5x5`` [m], or ``none`` for an open
            floor; larger where the mesh leaves the robot no way round it.

    Raises:
        UnknownNameError: There is no scene of this name, and it is no path.
        ConfigError: ``mesh_scale`` is not positive, ``room`` is no room, or SEED is not a whole
            number.
        SceneError: The file is missing or broken, or holds no target.

    >>> s3d.load_scene("three_boxes").tour
    'front'
    """
    if not (mesh_scale > 0 and np.isfinite(mesh_scale)):
        raise ConfigError(f"mesh scale must be > 0, got {mesh_scale:g}")
    size = parse_room(room)
    if name_or_path.startswith(NAME_PREFIX):
        return scene_of_seed(name_or_path)
    path = Path(name_or_path)
    suffix = path.suffix.lower()
    if suffix == ".xml" or suffix in MESH_SUFFIXES:
        if not path.is_file():
            raise SceneError(f"no file {name_or_path}")
        if suffix == ".xml":
            try_mjcf(path)
            return scene_from_spec(path.stem, _read_mjcf(path), name_or_path)
        check_size(path)
        with limited_memory(path):
            return scene_from_spec(path.stem, mesh_spec(path, mesh_scale, size), name_or_path)
    if name_or_path not in scene_names():
        raise UnknownNameError("scene", name_or_path, (*scene_names(), "random:SEED"))
    return scene_from_spec(
        name_or_path, _read_mjcf(find_resource_dir("scenes") / f"{name_or_path}.xml"), name_or_path
    )


def _read_mjcf(path: Path) -> Any:
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise SceneError(f"{path} is not valid MJCF: {one_line(error)}") from None
