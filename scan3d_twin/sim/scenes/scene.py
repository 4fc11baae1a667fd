"""Scenes: plain MJCF without a robot, or a mesh file, with the few conventions below.

* site ``spawn``: where the robot starts; its +x is the robot's heading.
* target: bodies or geoms named ``target*``, or ``<custom><tuple name="target">``.
* ``<custom><numeric name="scan3d.standoff"/>``: scanning distance [m], optional.
* ``<custom><numeric name="scan3d.friction"/>``: of the tyres on this floor, optional.
* ``<custom><text name="scan3d.tour" data="front|full"/>``; for front, a site ``front`` whose +x is
  the outward normal of the front.
* ``<custom><text name="scan3d.description" data="..."/>``: one line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import mujoco
import numpy as np

from scan3d_twin.core.config import Tour
from scan3d_twin.core.errors import SceneError
from scan3d_twin.core.types import Pose2
from scan3d_twin.sim.scenes.facing import Facing
from scan3d_twin.sim.scenes.orientation import find_facings
from scan3d_twin.sim.scenes.surface_samples import SAMPLED_TYPES
from scan3d_twin.sim.scenes.visibility import DRAWN_GROUPS, choose_seen_parts


@dataclass(frozen=True)
class Scene:
    """A scene without a robot.

    Attributes:
        name: Name in reports and folder names.
        spec: The editable model; copy before editing.
        model: The compiled model, against which the lidar's rays are cast.
        spawn: ``T_map_base`` at the start; ``map`` is the scene's own frame.
        tour: Whether it is scanned from the front or all round.
        standoff: Scanning distance [m]; None leaves it to the run's configuration.
        friction: Sliding friction of the tyres on this floor; None leaves it to the robot's errors.
        targets: Names of the geoms of each named target.
        front: Middle of the front, +x the outward normal, in ``map``; None for tour full.
        description: One line.
        facings: Which sides of the faces of the targets' meshes count, by geom.
        notes: What was repaired or guessed, in sentences.
    """

    name: str
    spec: Any
    model: Any
    spawn: Pose2
    tour: Tour
    standoff: float | None
    friction: float | None
    targets: Mapping[str, tuple[str, ...]]
    front: Pose2 | None
    description: str
    facings: Mapping[str, Facing] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def target_geoms(self) -> tuple[str, ...]:
        """Names of all target geoms, each once."""
        return tuple(dict.fromkeys(name for geoms in self.targets.values() for name in geoms))


def scene_from_spec(name: str, spec: Any, label: str) -> Scene:
    """Return the scene of an ``MjSpec`` without a robot, by the conventions above.

    Args:
        name: Name of the scene.
        spec: The model; a missing floor and missing names of target geoms are added.
        label: The file or name in messages.

    Raises:
        SceneError: The model does not compile, or has no target or spawn.
    """
    # Complete and compile the model
    _add_floor(spec)
    targets = _targets(spec, label)
    try:
        model = spec.copy().compile()
    except ValueError as error:
        raise SceneError(f"{label} does not compile: {one_line(error)}") from None
    targets = choose_seen_parts(model, targets, label)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    # Read tour, spawn and front
    texts = {text.name: text.data for text in spec.texts}
    tour = texts.get("scan3d.tour", "full")
    if tour not in ("front", "full"):
        raise SceneError(f"{label}: scan3d.tour must be front or full, got {tour!r}")
    spawn = _site_pose(model, data, "spawn")
    if spawn is None:
        raise SceneError(f"{label} has no site 'spawn'; add one where the robot starts")
    front = _site_pose(model, data, "front") if tour == "front" else None
    if tour == "front" and front is None:
        raise SceneError(f"{label} has tour front but no site 'front'; add one, +x outwards")

    # Turn the faces of meshes outwards
    facings = find_facings(model, targets, spawn)
    repairs = [facing.describe(name) for name, facing in facings.items()]

    # Return it with its options
    return Scene(
        name=name,
        spec=spec,
        model=model,
        spawn=spawn,
        tour=cast(Tour, tour),
        standoff=_positive(spec, "scan3d.standoff", "m", label),
        friction=_positive(spec, "scan3d.friction", "", label),
        targets=targets,
        front=front,
        description=texts.get("scan3d.description", ""),
        facings=facings,
        notes=tuple(repair for repair in repairs if repair),
    )


def _add_floor(spec: Any) -> None:
    """Add a floor at z = 0 unless there is a plane or a geom named ``floor*``."""
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    if not any(geom.type == plane or geom.name.startswith("floor") for geom in spec.geoms):
        spec.worldbody.add_geom(
            name="floor", type=plane, size=[0, 0, 0.1], rgba=[0.55, 0.55, 0.55, 1]
        )


def _targets(spec: Any, label: str) -> dict[str, tuple[str, ...]]:
    """Return the geom names of each target, after naming unnamed geoms of target bodies."""
    # Collect geoms of target bodies
    bodies, geoms = _target_names(spec)
    targets = {}
    for name in bodies:
        body = spec.body(name)
        parts = body.find_all("geom") if body is not None else []
        for number, geom in enumerate(parts):
            geom.name = geom.name or f"{name}/{number}"
        if parts:
            targets[name] = tuple(geom.name for geom in parts)

    # Collect single target geoms
    for name in geoms:
        if name not in targets and not any(name in parts for parts in targets.values()):
            targets[name] = (name,)
            _name_neighbours(spec, name)
    if not targets:
        raise SceneError(
            f"{label} has no target; name a geom or body 'target...' or add <tuple name=\"target\">"
        )

    # Refuse geoms that are not solid
    for name in (name for parts in targets.values() for name in parts):
        geom = spec.geom(name)
        if geom is None:
            raise SceneError(f"{label}: the tuple 'target' names {name!r}, which is no geom")
        if geom.type not in SAMPLED_TYPES:
            raise SceneError(f"{label}: target {name!r} must be a solid primitive or a mesh")
    return targets


def _name_neighbours(spec: Any, name: str) -> None:
    """Name the geoms of the body of geom ``name``, for which it may stand in."""
    geom = spec.geom(name)
    if geom is None or (geom.parent.name == "world" and geom.group < DRAWN_GROUPS):
        return
    for number, other in enumerate(geom.parent.geoms):
        other.name = other.name or f"{name}/{number}"


def _target_names(spec: Any) -> tuple[list[str], list[str]]:
    """Return the names of target bodies and target geoms."""
    for group in spec.tuples:
        if group.name == "target":
            pairs = list(zip(group.objtype, group.objname, strict=True))
            body, geom = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_GEOM
            return [n for t, n in pairs if t == body], [n for t, n in pairs if t == geom]
    return (
        [body.name for body in spec.bodies if body.name.startswith("target")],
        [geom.name for geom in spec.geoms if geom.name.startswith("target")],
    )


def _positive(spec: Any, name: str, unit: str, label: str) -> float | None:
    """Return the positive number ``name`` of the scene; None if it states none."""
    for numeric in spec.numerics:
        if numeric.name == name:
            value = float(np.atleast_1d(numeric.data)[0])
            if not (value > 0 and np.isfinite(value)):
                limit = f"> 0 {unit}".rstrip()
                raise SceneError(f"{label}: {name} must be {limit}, got {value:g}")
            return value
    return None


def _site_pose(model: Any, data: Any, name: str) -> Pose2 | None:
    """Return the planar pose of a site in ``map``; None when there is no such site."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if site < 0:
        return None
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    return Pose2.from_matrix(T)


def one_line(error: Exception) -> str:
    """Return the message of ``error`` on one line."""
    return " ".join(str(error).split())
