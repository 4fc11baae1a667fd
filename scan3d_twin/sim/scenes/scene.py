"""Scenes: plain MJCF without a robot, or a mesh file, with the few conventions below.

* site ``spawn``: where the robot starts; its +x is the robot's heading. Without it, free floor in
  sight of the target (``free_floor.py``).
* target: the body or geom that is asked for; else bodies or geoms named ``target*``, or
  ``<custom><tuple name="target">``.
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
from scan3d_twin.core.errors import SceneError, UnknownNameError
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.sim.scenes.facing import Facing
from scan3d_twin.sim.scenes.mjcf.floors import (
    bound_planes,
    compile_scene,
    lay_floor,
    name_planes,
    widen_floors,
)
from scan3d_twin.sim.scenes.mjcf.free_floor import choose_spawn, corners, rings
from scan3d_twin.sim.scenes.mjcf.freeze import freeze
from scan3d_twin.sim.scenes.mjcf.settings import reset_settings, unify_contacts
from scan3d_twin.sim.scenes.mjcf.target_sight import TargetSight
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
        return _each_once(self.targets)


def scene_from_spec(
    name: str, spec: Any, label: str, target: str = "", keyframe: str = ""
) -> Scene:
    """Return the scene of an ``MjSpec`` without a robot, by the conventions above.

    Args:
        name: Name of the scene.
        spec: The model; changed in place: its settings (``settings.py``), joints (``freeze.py``)
            and floor (``floors.py``) become those of the twin, and target geoms get names.
        label: The file or name in messages.
        target: Name of the body or geom that is the target; empty, or a target by the conventions,
            leaves these.
        keyframe: Name of the keyframe that poses the joints; empty for the reference pose.

    Raises:
        UnknownNameError: There is no such body or geom, or no such keyframe.
        SceneError: The model does not compile, has no target, or no place for the robot.
    """
    # Give it the twin's settings and put it at rest
    reset_settings(spec)
    freeze(spec, keyframe, label)
    unify_contacts(spec)
    name_planes(spec)
    targets = _targets(spec, label, target)

    # Lay the floor and find the start
    model, around = _lay_ground(spec, targets, label)
    targets = choose_seen_parts(model, targets, label)
    spawn = _site_pose(model, "spawn")
    if spawn is None:
        spawn = choose_spawn(model, spec, _each_once(targets), around, label)

    # Turn the faces of meshes outwards
    facings = find_facings(model, targets, spawn)
    notes = [facing.describe(name) for name, facing in facings.items()]
    notes += [_describe_cover(model, targets[target], target, spawn)] if target in targets else []

    # Read its options
    tour, front = _read_tour(spec, model, label)
    return Scene(
        name=name,
        spec=spec,
        model=model,
        spawn=spawn,
        tour=tour,
        standoff=_positive(spec, "scan3d.standoff", "m", label),
        friction=_positive(spec, "scan3d.friction", "", label),
        targets=targets,
        front=front,
        description=_texts(spec).get("scan3d.description", ""),
        facings=facings,
        notes=tuple(note for note in notes if note),
    )


def _read_tour(spec: Any, model: Any, label: str) -> tuple[Tour, Pose2 | None]:
    """Return the tour of a scene, and the middle of its front where it is scanned from there."""
    tour = _texts(spec).get("scan3d.tour", "full")
    if tour not in ("front", "full"):
        raise SceneError(f"{label}: scan3d.tour must be front or full, got {tour!r}")
    front = _site_pose(model, "front") if tour == "front" else None
    if tour == "front" and front is None:
        raise SceneError(f"{label} has tour front but no site 'front'; add one, +x outwards")
    return cast(Tour, tour), front


def _texts(spec: Any) -> dict[str, str]:
    """Return the custom texts of a scene by name."""
    return {text.name: text.data for text in spec.texts}


def _each_once(targets: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return the names of all geoms of ``targets``, each once."""
    return tuple(dict.fromkeys(name for geoms in targets.values() for name in geoms))


def _lay_ground(
    spec: Any, targets: Mapping[str, tuple[str, ...]], label: str
) -> tuple[Any, FloatArray]:
    """Lay the floor of ``spec`` at z = 0; return the model and the target's corners (n, 3) [m]."""
    # Find the floor, or add one
    geoms = _each_once(targets)
    copy = spec.copy()
    model = compile_scene(copy, label)
    around, frame = corners(model, geoms), _site_frame(model, "spawn")
    site = None if frame is None else frame[:3, 3]
    starts = rings(around) if site is None else (site[None],)
    fallback = min(0.0, float(around[:, 2].min())) if site is None else float(site[2])
    if lay_floor(spec, (copy, model), starts, set(geoms), fallback):
        model = compile_scene(spec.copy(), label)
        around = corners(model, geoms)

    # Let it reach where the robot drives, and walls end where they are seen to end
    places = around if site is None else np.vstack([around, (site[0], site[1], 0.0)])
    widened, bounded = widen_floors(spec, model, places), bound_planes(spec, model)
    if widened or bounded:
        model = compile_scene(spec.copy(), label)
    return model, around


def _describe_cover(model: Any, geoms: tuple[str, ...], target: str, spawn: Pose2) -> str:
    """Return what hides the named ``target`` from the start, in a sentence; empty if it is seen."""
    sight, place = TargetSight(model, geoms), np.array([spawn.x, spawn.y])
    if sight.shares(place[None])[0] > 0:
        return ""
    return f"Target {target} is not seen from the start: {sight.find_cover(place)}."


def _targets(spec: Any, label: str, wanted: str) -> dict[str, tuple[str, ...]]:
    """Return the geom names of each target, after naming unnamed geoms of target bodies.

    A ``wanted`` body or geom that is no target by the conventions is the only one.
    """
    # Collect geoms of target bodies
    bodies, geoms = _target_names(spec)
    if wanted and wanted not in (*bodies, *geoms):
        bodies, geoms = _named_target(spec, wanted)
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
        names = _names(spec)
        known = f", such as {names[0]}" if names else ""
        raise SceneError(
            f"{label} has no target; give --target BODY with a body or geom of the file{known}, or "
            "name one 'target...'"
        )

    _refuse_unsampled(spec, targets, label)
    return targets


def _refuse_unsampled(spec: Any, targets: Mapping[str, tuple[str, ...]], label: str) -> None:
    """Refuse targets whose surface cannot be sampled, or that are no geoms."""
    for name in (name for parts in targets.values() for name in parts):
        geom = spec.geom(name)
        if geom is None:
            raise SceneError(f"{label}: the tuple 'target' names {name!r}, which is no geom")
        if geom.type not in SAMPLED_TYPES:
            kind = geom.type.name.removeprefix("mjGEOM_").lower()
            raise SceneError(
                f"{label}: target {name!r} must be a solid primitive or a mesh, not of type {kind}"
            )


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


def _named_target(spec: Any, name: str) -> tuple[list[str], list[str]]:
    """Return the body or the geom of this ``name``.

    Raises:
        UnknownNameError: There is no such body or geom.
        SceneError: The body has no geom.
    """
    body = spec.body(name)
    if body is not None and not body.find_all("geom"):
        raise SceneError(f"body {name!r} has no geom; name a body or geom with one as the target")
    if body is not None:
        return [name], []  # before a geom of the same name
    if spec.geom(name) is not None:
        return [], [name]
    raise UnknownNameError("target", name, _names(spec))


def _names(spec: Any) -> list[str]:
    """Return the names of all bodies and geoms that can be a target."""
    bodies = [body.name for body in spec.bodies[1:] if body.find_all("geom")]
    geoms = [geom.name for geom in spec.geoms if geom.type in SAMPLED_TYPES]
    return sorted({name for name in (*bodies, *geoms) if name})


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


def _site_pose(model: Any, name: str) -> Pose2 | None:
    """Return the planar pose of a site in ``map``; None when there is no such site."""
    T = _site_frame(model, name)
    return None if T is None else Pose2.from_matrix(T)


def _site_frame(model: Any, name: str) -> FloatArray | None:
    """Return the frame (4, 4) [m] of a site in that of the file; None if there is no such site."""
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name)
    if site < 0:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
    return T


def one_line(error: Exception) -> str:
    """Return the message of ``error`` on one line."""
    return " ".join(str(error).split())
