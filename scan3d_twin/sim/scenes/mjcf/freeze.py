"""A scene at rest: what hangs on joints is fixed where a keyframe or the reference pose has it.

A target has to keep its shape while it is scanned, and the actuators, tendons and equality
constraints that would hold it belong to another program. So joints are removed and each body is
placed where forward kinematics has it; flexes become the triangles or rods of their shape there.
A loose object, which is a body with a free joint, something solid and no other joint, stays loose:
it falls, comes to rest, and the robot can push it.
"""

from __future__ import annotations

import warnings
from typing import Any

import mujoco
import numpy as np

from scan3d_twin.core.errors import SceneError, UnknownNameError
from scan3d_twin.core.types import FloatArray
from scan3d_twin.sim.scenes.mjcf.floors import compile_scene

_OBJECT = mujoco.mjtObj


def freeze(spec: Any, keyframe: str, label: str) -> None:
    """Fix all bodies of ``spec`` but loose objects.

    Args:
        spec: The scene; changed in place.
        keyframe: Name of the keyframe that poses the bodies; empty for the reference pose.
        label: The file or name in messages.

    Raises:
        UnknownNameError: There is no such keyframe.
        SceneError: The scene does not compile, or a frame scales a body with joints.
    """
    if keyframe and not any(key.name == keyframe for key in spec.keys):
        raise UnknownNameError("keyframe", keyframe, [key.name for key in spec.keys if key.name])
    if not (_moving(spec) or spec.keys or spec.flexes):
        return

    # Remove what acts on joints
    fixed = [body for body in _moving(spec) if not _is_loose(spec, body)]
    _delete_actors(spec)
    for body in fixed:
        _weigh(body)

    # Place the bodies
    compiled = spec.copy()
    model, data = _pose(compiled, keyframe, label)
    for body, twin in zip(spec.bodies, compiled.bodies, strict=True):
        if body.joints or body.mocap:
            _place(body, model, data, int(twin.id), label)
    _fix_flexes(spec, compiled, model, data)

    # Remove the joints
    for body in fixed:
        body.mocap = False
        for joint in tuple(body.joints):
            spec.delete(joint)
    for key in tuple(spec.keys):
        spec.delete(key)


def _moving(spec: Any) -> list[Any]:
    """Return the bodies of ``spec`` that have a joint or are moved by the user."""
    return [body for body in spec.bodies if body.joints or body.mocap]


def _is_loose(spec: Any, body: Any) -> bool:
    """Return whether ``body`` is an object of its own that can fall, rest and be pushed."""
    free = mujoco.mjtJoint.mjJNT_FREE
    joints = body.find_all("joint")
    solid = any(geom.contype or geom.conaffinity for geom in body.find_all("geom"))
    held = any(body.name and body.name in (pair.name1, pair.name2) for pair in spec.equalities)
    return len(joints) == 1 and joints[0].type == free and bool(body.joints) and solid and not held


def _delete_actors(spec: Any) -> None:
    """Delete what acts on joints or reads them; keyframes keep only positions."""
    for kind in (spec.sensors, spec.actuators, spec.tendons, spec.equalities):
        for element in tuple(kind):
            spec.delete(element)
    for key in spec.keys:
        key.ctrl, key.act, key.qvel = [], [], []


def _weigh(body: Any) -> None:
    """Give ``body`` some inertia, so that it compiles; at rest it does not matter which."""
    body.explicitinertial = True
    body.mass, body.inertia, body.fullinertia = 1.0, [1.0, 1.0, 1.0], [np.nan] * 6
    body.ipos, body.iquat = [0, 0, 0], [1, 0, 0, 0]
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    for joint in body.joints:
        joint.align = 0


def _pose(spec: Any, keyframe: str, label: str) -> tuple[Any, Any]:
    """Compile ``spec``; return the model and its data at ``keyframe``."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about flexes whose equality constraints are gone
        model = compile_scene(spec, label)
    data = mujoco.MjData(model)
    if keyframe:
        mujoco.mj_resetDataKeyframe(model, data, model.key(keyframe).id)
    mujoco.mj_fwdPosition(model, data)
    return model, data


def _place(body: Any, model: Any, data: Any, k: int, label: str) -> None:
    """Let ``body``, number ``k`` of ``model``, have its pose of ``data`` in a frame of its own."""
    # Refuse frames that scale
    frame = body.frame
    while frame is not None:
        if not np.all(np.equal(frame.scale, 1.0)):
            raise SceneError(
                f"{label}: body {body.name!r} has a joint in a frame with scale; leave one out"
            )
        frame = frame.frame

    # Compute the pose relative to the parent
    parent = int(model.body_parentid[k])
    inverse, place, turn = np.zeros(4), np.zeros(3), np.zeros(4)
    mujoco.mju_negQuat(inverse, data.xquat[parent])
    mujoco.mju_rotVecQuat(place, data.xpos[k] - data.xpos[parent], inverse)
    mujoco.mju_mulQuat(turn, inverse, data.xquat[k])

    # Put it there
    body.set_frame(body.parent.add_frame())
    body.pos, body.quat = place, turn
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _fix_flexes(spec: Any, compiled: Any, model: Any, data: Any) -> None:
    """Replace the flexes of ``spec`` by geoms in their shape of ``data``, without contacts."""
    for flex, twin in zip(tuple(spec.flexes), tuple(compiled.flexes), strict=True):
        k = int(twin.id)
        first, count = int(model.flex_vertadr[k]), int(model.flex_vertnum[k])
        vertices: FloatArray = np.array(data.flexvert_xpos[first : first + count])
        rgba, radius = np.array(model.flex_rgba[k]), float(model.flex_radius[k])
        if model.flex_dim[k] == 1:
            _add_rods(spec, flex.name, vertices[_elements(model, k, 2)], radius, rgba)
        else:
            _add_sheet(spec, flex.name, vertices, _surface(model, k), rgba)
        spec.delete(flex)


def _elements(model: Any, k: int, corners: int) -> Any:
    """Return the elements of flex ``k`` as local vertex numbers (m, corners)."""
    first, count = int(model.flex_elemdataadr[k]), int(model.flex_elemnum[k])
    return np.array(model.flex_elem[first : first + corners * count]).reshape(-1, corners)


def _surface(model: Any, k: int) -> Any:
    """Return the triangles of flex ``k``, or those of its shell if it is a volume, (m, 3)."""
    if model.flex_dim[k] == 2:
        return _elements(model, k, 3)
    first, count = int(model.flex_shelldataadr[k]), int(model.flex_shellnum[k])
    return np.array(model.flex_shell[first : first + 3 * count]).reshape(-1, 3)


def _add_rods(spec: Any, name: str, ends: FloatArray, radius: float, rgba: FloatArray) -> None:
    """Add a capsule for each pair of ``ends`` (m, 2, 3) [m]."""
    for number, (a, b) in enumerate(ends):
        spec.worldbody.add_geom(
            name=f"{name}/{number}",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*a, *b],
            size=[max(radius, 1e-4), 0, 0],
            rgba=rgba,
            contype=0,
            conaffinity=0,
        )


def _add_sheet(spec: Any, name: str, vertices: FloatArray, faces: Any, rgba: FloatArray) -> None:
    """Add a mesh of ``vertices`` (n, 3) [m] and ``faces`` (m, 3)."""
    spec.add_mesh(
        name=f"{name}/flex",
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"{name}/flex",
        rgba=rgba,
        contype=0,
        conaffinity=0,
    )
