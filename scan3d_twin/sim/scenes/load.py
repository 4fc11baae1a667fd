"""Loading scenes: those that come with the package, random ones, and files of any place."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import ConfigError, SceneError, UnknownNameError
from scan3d_twin.sim.mesh_up import parse_mesh_up
from scan3d_twin.sim.mujoco_log import write_no_log_file
from scan3d_twin.sim.resources import find_resource_dir
from scan3d_twin.sim.room import DEFAULT_ROOM, parse_room
from scan3d_twin.sim.scenes.meshes.files import MESH_SUFFIXES, refuse_other_format
from scan3d_twin.sim.scenes.meshes.spec import complete_obj_meshes, mesh_spec
from scan3d_twin.sim.scenes.mjcf.trial import COPIES, check_size, limited_memory, try_mjcf
from scan3d_twin.sim.scenes.random_scenes import NAME_PREFIX, scene_of_seed
from scan3d_twin.sim.scenes.scene import Scene, one_line, scene_from_spec


def scene_names() -> tuple[str, ...]:
    """Return the names of the scenes that come with the package, sorted.

    >>> "sine_box" in s3d.scene_names()
    True
    """
    return tuple(sorted(path.stem for path in find_resource_dir("scenes").glob("*.xml")))


def load_scene(
    name_or_path: str,
    mesh_scale: float = 1.0,
    room: str = DEFAULT_ROOM,
    mesh_up: str = "auto",
    *,
    target: str = "",
    keyframe: str = "",
) -> Scene:
    """Return a built-in scene by name, or an MJCF or mesh file by path.

    Args:
        name_or_path: A name of ``scene_names()``, ``random:SEED``, or a path that ends in .xml .stl
            .ply .obj .glb .gltf .off.
        mesh_scale: Metres per unit of a mesh file.
        room: Room around a mesh: width by depth, such as ``5x5`` [m], or ``none`` for an open
            floor; larger where the mesh leaves the robot no way round it.
        mesh_up: Axis of a mesh file that is up: ``y``, ``z``, or ``auto``, which is y in glTF by
            definition and else guessed; ``Scene.notes`` says so.
        target: Name of the body or geom to scan; empty for those that the scene declares.
        keyframe: Name of the keyframe at which an MJCF file's joints are frozen; empty for their
            reference pose.

    Raises:
        UnknownNameError: There is no scene, target or keyframe of this name.
        ConfigError: ``mesh_scale`` is not positive, ``room`` is no room, ``mesh_up`` no axis, or
            SEED is not a whole number.
        SceneError: The file is missing or broken, holds no target, or leaves the robot no place.

    >>> s3d.load_scene("three_boxes").tour
    'front'
    """
    if not (mesh_scale > 0 and np.isfinite(mesh_scale)):
        raise ConfigError(f"mesh scale must be > 0, got {mesh_scale:g}")
    size, up = parse_room(room), parse_mesh_up(mesh_up)
    write_no_log_file()

    if name_or_path.startswith(NAME_PREFIX):
        scene = scene_of_seed(name_or_path)
        if not target and not keyframe:
            return scene
        return scene_from_spec(scene.name, scene.spec, name_or_path, target, keyframe)
    path = Path(name_or_path)
    suffix = path.suffix.lower()
    if suffix == ".xml" or suffix in MESH_SUFFIXES:
        if not path.is_file():
            raise SceneError(f"no file {name_or_path}")
        if suffix == ".xml":
            try_mjcf(path)
        else:
            check_size(path)
        with limited_memory(path):
            if suffix == ".xml":
                spec = _read_mjcf(path)
                notes = complete_obj_meshes(spec)
            else:
                spec, notes = mesh_spec(path, mesh_scale, size, up)
        with limited_memory(path, COPIES):
            scene = scene_from_spec(path.stem, spec, name_or_path, target, keyframe)
        return replace(scene, notes=(*notes, *scene.notes))
    if name_or_path not in scene_names():
        refuse_other_format(path)
        raise UnknownNameError("scene", name_or_path, (*scene_names(), "random:SEED"))
    spec = _read_mjcf(find_resource_dir("scenes") / f"{name_or_path}.xml")
    return scene_from_spec(name_or_path, spec, name_or_path, target, keyframe)


def _read_mjcf(path: Path) -> Any:
    try:
        return mujoco.MjSpec.from_file(str(path))
    except (ValueError, OSError) as error:
        raise SceneError(f"{path} is not valid MJCF: {one_line(error)}") from None
