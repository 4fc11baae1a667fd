"""The true target of a recorded simulated run, laid where the run placed it."""

from __future__ import annotations

import mujoco
import numpy as np

from scan3d_twin.core.errors import RegistrationError, SceneError
from scan3d_twin.core.model.fused_cloud import build_model
from scan3d_twin.core.registration import register
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import FloatArray, Pose2
from scan3d_twin.recording.load import RecordedRun
from scan3d_twin.run.resolve import load_run_scene
from scan3d_twin.sim.scenes.scene import Scene
from scan3d_twin.sim.scenes.surface_samples import sample_geom
from scan3d_twin.sim.scenes.tessellation import TRIANGULATED_TYPES, geom_triangles
from scan3d_twin.sim.scenes.visibility import GROUNDS

SAMPLE_SPACING = 0.02
"""Spacing of the samples of the scene on which the model is laid [m]."""
MAX_START_DISTANCE = 0.3
"""Distance of the robot's start from the scene's, beyond which a registration is wrong [m]."""

SHOWN_TYPES = {int(kind) for kind in TRIANGULATED_TYPES} - {int(kind) for kind in GROUNDS}
"""Types of the geoms that are shown: the ground would hide all else."""


def lay_on_scene(session: Session, scene: Scene) -> Pose2:
    """Return ``T_map_world``: the model laid on the target, beginning with the robot's start."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    samples = []
    for name in scene.target_geoms:
        geom = data.geom(name)
        local, _ = sample_geom(scene.model, geom.id, SAMPLE_SPACING)
        samples.append(local @ geom.xmat.reshape(3, 3).T + geom.xpos)
    try:
        result = register(
            np.concatenate(samples),
            build_model(session, SAMPLE_SPACING).points,
            init_T_target_source=scene.spawn,
        )
    except RegistrationError:
        return scene.spawn
    found = Pose2.from_matrix(result.T_target_source)
    return found if found.distance(scene.spawn) < MAX_START_DISTANCE else scene.spawn


def true_triangles(run: RecordedRun) -> FloatArray:
    """Return the triangles (m, 3, 3) of the true target of ``run`` in ``world`` [m].

    Raises:
        UnknownNameError: The scene is gone.
        SceneError: It cannot be read or built, or has no target of triangles.
    """
    scene = load_run_scene(run.settings.run)
    T_world_map = lay_on_scene(run.session, scene).inverse()
    return T_world_map.apply(scene_triangles(scene).reshape(-1, 3)).reshape(-1, 3, 3)


def scene_triangles(scene: Scene) -> FloatArray:
    """Return the triangles (m, 3, 3) of the target of ``scene`` in ``map`` [m].

    Raises:
        SceneError: It has none.
    """
    data = mujoco.MjData(scene.model)
    mujoco.mj_forward(scene.model, data)
    found = []
    for name in scene.target_geoms:
        geom = data.geom(name)
        if int(scene.model.geom_type[geom.id]) in SHOWN_TYPES:
            rotation = geom.xmat.reshape(3, 3)
            found.append(geom_triangles(scene.model, geom.id) @ rotation.T + geom.xpos)
    if not found:
        raise SceneError(f"the target of {scene.name} has no surface of triangles")
    return np.concatenate(found)
