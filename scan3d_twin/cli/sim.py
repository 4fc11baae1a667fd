"""``twin sim``: digitise a scene with the twin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from scan3d_twin.cli.dotted import ENVIRONMENT, dotted_options, stated
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.core.presets import preset
from scan3d_twin.recording.settings import (
    Options,
    Settings,
    merge,
    read_settings,
    settings,
    world_options,
)

if TYPE_CHECKING:
    from scan3d_twin.sim.scene import Scene

    DottedOptions = Any
else:
    DottedOptions = dotted_options()


def _env(name: str) -> Parameter:
    return Parameter(env_var=ENVIRONMENT + name)


@dataclass(frozen=True, kw_only=True)
class SimOptions:
    """The options people use most; None is not stated."""

    scene: Annotated[str | None, _env("SCENE")] = None
    """Name of a scene (`twin scenes`), or an .xml, .stl, .ply, .obj or .glb file (default
    three_boxes)."""
    epsilon: Annotated[float | None, _env("EPSILON")] = None
    """Wanted registration error, root mean square [mm] (default 10)."""
    tour: Annotated[Literal["front", "full"] | None, _env("TOUR")] = None
    """Scan the front only, or all round (default: the scene's)."""
    robot: Annotated[str | None, _env("ROBOT")] = None
    """Robot profile: create1 or create2 (default create2)."""
    world: Annotated[str | None, _env("WORLD")] = None
    """Named errors of robot, lidar and floor: ideal, typical or harsh (default typical)."""
    lidar_link: Annotated[str | None, _env("LIDAR_LINK")] = None
    """Link of the lidar: usb (682 steps, 10 Hz), 115200 (357 steps, 10 Hz) or 115200-full
    (682 steps, 5 Hz) (default usb)."""
    planner: Annotated[str | None, _env("PLANNER")] = None
    """Name of the planner, see `twin planners` (default: the preset's)."""
    preset: Annotated[str | None, _env("PRESET")] = None
    """Named set of options: paper (default paper)."""
    seed: Annotated[int | None, _env("SEED")] = None
    """The run's one seed; the same seed gives the same files (default 0)."""
    max_views: Annotated[int | None, _env("MAX_VIEWS")] = None
    """Stop after this many views (default 20)."""
    target: Annotated[str | None, Parameter(env_var="TWIN_TARGET", allow_leading_hyphen=True)] = (
        None
    )
    """What to scan: a target's name, or its place x,y in the odometry frame [m] (default: what
    stands out)."""
    mesh_scale: Annotated[float | None, _env("MESH_SCALE")] = None
    """Metres per unit of a mesh file (default 1)."""
    config: Annotated[Path | None, _env("CONFIG")] = None
    """TOML file with options; the command line and the environment win over it."""
    out: Annotated[Path | None, _env("OUT")] = None
    """Folder for the results, new or empty (default runs/SCENE-TIME)."""
    json: bool = False
    """Print the report, and nothing else, on standard output."""


def sim(
    *,
    options: Annotated[SimOptions, Parameter(name="*")] = SimOptions(),
    dotted: Annotated[DottedOptions, Parameter(name="*")] = None,
) -> None:
    """Digitise a scene with the twin.

    Drives the simulated robot round the target, scans it, and writes model.ply, report.json,
    top_view.svg, config.toml and views/NNN.npz. Later ones win: defaults, scene, preset, --config
    FILE, environment (TWIN_EPSILON, TWIN_PLANNING_TRIALS, ...), command line.

    Raises:
        TwinError: Whatever keeps the scan from being done; what was scanned by then is saved.
    """
    from scan3d_twin.cli.run import run_sim

    effective, scene = resolve(options, {} if dotted is None else stated(dotted))
    run_sim(effective, scene, options.out, as_json=options.json)


def resolve(options: SimOptions, sections: Options) -> tuple[Settings, Scene]:
    """Return the effective settings and the scene they name."""
    from scan3d_twin.core.planning import make_planner
    from scan3d_twin.sim.scene import load_scene

    file = {} if options.config is None else read_settings(options.config)
    given = merge([file, sections, _flat(options, sections)])
    run = settings([given]).run
    named = [world_options(run.world), preset(run.preset)]
    effective = settings([*named, given])
    make_planner(effective.config.planner)
    scene = load_scene(effective.run.scene, effective.run.mesh_scale)
    return settings([_of_scene(scene), *named, given]), scene


def _of_scene(scene: Scene) -> Options:
    """Return what ``scene`` says about how it is to be scanned."""
    standoff = {} if scene.standoff is None else {"standoff": scene.standoff}
    return {"tour": scene.tour, "planning": standoff}


def _flat(options: SimOptions, sections: Options) -> Options:
    """Return the flat options where they belong in a configuration, in SI units."""
    run, top = {}, {}
    for name, value in _given(options):
        if name == "scene":
            run[name] = _absolute(value)
        elif name in ("seed", "preset", "world", "target", "mesh_scale"):
            run[name] = value
        elif name in ("tour", "planner", "max_views", "robot", "lidar_link"):
            top[name] = value
    planning = {}
    if options.epsilon is not None:
        if "epsilon" in sections.get("planning", {}):
            raise ConfigError("--epsilon [mm] and --planning.epsilon [m] are the same; give one")
        planning["epsilon"] = options.epsilon / 1e3
    return {**top, "run": run, "planning": planning}


def _absolute(scene: str) -> str:
    """Return the path of a scene file so that it is found from any folder; a name as it is."""
    path = Path(scene)
    return str(path.resolve()) if path.suffix and path.is_file() else scene


def _given(options: SimOptions) -> Iterator[tuple[str, Any]]:
    for field in fields(options):
        value = getattr(options, field.name)
        if value is not None:
            yield field.name, value
