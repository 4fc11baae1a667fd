"""``twin sim``: digitise a scene with the twin."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from scan3d_twin.cli.begin import begun
from scan3d_twin.cli.dotted import dotted_options, stated
from scan3d_twin.cli.options import RunOptions, SceneOptions, TurntableOptions, stated_options
from scan3d_twin.cli.output import say
from scan3d_twin.cli.viewing import ViewOptions
from scan3d_twin.core.config import Config
from scan3d_twin.run.settings import Options, Settings
from scan3d_twin.sim.config import TwinConfig

if TYPE_CHECKING:
    from pathlib import Path

    from scan3d_twin.api.resume import ResumedRun
    from scan3d_twin.core.types import FloatArray
    from scan3d_twin.run.closed_loop import RobotContext
    from scan3d_twin.sim.scenes.scene import Scene

    DottedOptions = Any
else:
    DottedOptions = dotted_options(Config, TwinConfig)


SPEED = "10x"
"""Initial speed of a twin that is watched: a run of three minutes takes twenty seconds."""


@dataclass(frozen=True, kw_only=True)
class SimOptions(ViewOptions, RunOptions, TurntableOptions, SceneOptions):
    """The options of the twin; None is not stated."""


def sim(
    *,
    options: Annotated[SimOptions, Parameter(name="*")] = SimOptions(),
    dotted: Annotated[DottedOptions | None, Parameter(name="*")] = None,
) -> None:
    """Digitise a scene with the twin.

    Drives the simulated robot round the target, scans it, and writes model.ply, report.json,
    top_view.svg, config.toml and views/NNN.npz. Later sources take precedence: defaults, scene,
    preset, --config FILE, environment (TWIN_EPSILON, TWIN_PLANNING_TRIALS, ...), command line.

    Raises:
        TwinError: The scan failed or was stopped; the views finished by then are saved.
    """
    from scan3d_twin.run.resolve import is_mesh_file

    def picture() -> bytes:
        from scan3d_twin.api.sim import draw_scene  # slow to import

        return draw_scene(scene, effective.twin.robot)

    def surface() -> FloatArray:
        from scan3d_twin.viz.true_scene import scene_triangles

        return scene_triangles(scene)

    watch = options.watch(SPEED, picture, surface)  # obeys commands from here on
    given = {} if dotted is None else stated(dotted)
    if options.resume is None:
        resume, (effective, scene) = None, resolve(options, given)
    else:
        resume, scene = _going_on(options, options.resume, given)
        effective = resume.settings
    if is_mesh_file(effective.run.scene):
        say(f"{scene.description}; --mesh-up and --mesh-scale change that")
    for note in scene.notes:
        say(note)

    if options.targets is not None:
        from scan3d_twin.cli.multi_target import run_each

        run_each(
            effective,
            scene.name,
            _opened(scene, effective),
            options.out,
            options.targets,
            as_json=options.json,
            watch=watch,
        )
        return
    with begun(scene.name, options.out) if resume is None else nullcontext(resume.folder) as folder:
        from scan3d_twin.cli.run import run

        run(
            effective,
            scene.name,
            _opened(scene, effective),
            folder,
            as_json=options.json,
            resume=resume,
            watch=watch,
        )


def _opened(scene: Scene, effective: Settings) -> RobotContext:
    """Return what opens the twin in ``scene``."""
    from scan3d_twin.sim.robot import open_sim

    return open_sim(scene, effective.run.seed, effective.twin)


def resolve(options: SimOptions, sections: Options) -> tuple[Settings, Scene]:
    """Return the effective settings and the scene they name."""
    from scan3d_twin.run.resolve import resolve_sim

    return resolve_sim(stated_options(options, sections))


def _going_on(options: SimOptions, folder: Path, sections: Options) -> tuple[ResumedRun, Scene]:
    """Return how the run in ``folder`` goes on, and its scene."""
    from scan3d_twin.api.resume import resume_sim
    from scan3d_twin.cli.multi_target import refuse_resume
    from scan3d_twin.run.resolve import load_run_scene

    refuse_resume(folder, options.targets)
    resume = resume_sim(folder, options.out, stated_options(options, sections))
    run = resume.settings.run
    return resume, load_run_scene(run)
