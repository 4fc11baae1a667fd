"""The options that several commands have, and how they become settings.

No postponed annotations here: those of inherited fields are looked up where the child is defined.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from scan3d_twin.cli.defaults import PREFIX, default_text
from scan3d_twin.core.config import Pattern
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.run.settings import Options, absolute_scene, merge_options, read_settings


def env(name: str, default: str | None = None) -> Parameter:
    """Return a parameter that the variable TWIN_``name`` sets too.

    Args:
        name: The variable's name without its prefix.
        default: What help pages show as the default, see ``default_text``; None shows the default
            of the field itself.
    """
    if default is None:
        return Parameter(env_var=PREFIX + name)
    return Parameter(env_var=PREFIX + name, show_default=lambda _: default_text(default))


@dataclass(frozen=True, kw_only=True)
class TurntableOptions:
    """What turns the lidar; None is not stated."""

    pattern: Annotated[Pattern | None, env("PATTERN")] = None
    """Base or table turns the lidar."""
    turntable: Annotated[str | None, env("TURNTABLE"), Parameter(show=False)] = None
    """Name of the turntable: xl330 or ideal."""
    base: Annotated[str | None, Parameter(show=False)] = None
    """Another name of ``--robot``: a stand is none."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions(TurntableOptions):
    """What only the twin has a choice of; None is not stated."""

    scene: Annotated[str | None, env("SCENE", "{run.scene}")] = None
    """Name (`twin scenes`), random:SEED, MJCF or mesh file."""
    mesh_scale: Annotated[float | None, env("MESH_SCALE", "{run.mesh_scale:g}")] = None
    """Metres per unit of a mesh file."""
    mesh_up: Annotated[str | None, env("MESH_UP", "{run.mesh_up}")] = None
    """Its axis that is up: y, z, auto."""
    room: Annotated[str | None, env("ROOM", "{run.room}")] = None
    """Room of a mesh: WxD [m], or none."""
    keyframe: Annotated[str | None, env("KEYFRAME", "reference pose")] = None
    """Keyframe for an .xml."""
    robot: Annotated[str | None, env("ROBOT", "{twin.robot}")] = None
    """Name of the base (`twin devices`)."""
    lidar: Annotated[str | None, env("LIDAR", "{twin.lidar_model}")] = None
    """Name of the lidar (`twin devices`)."""
    world: Annotated[str | None, env("WORLD", "{run.world}")] = None
    """Twin's errors: ideal, typical, harsh, unfiltered."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options of a run, of the twin or the real robot; None is not stated."""

    epsilon: Annotated[float | None, env("EPSILON", "{epsilon_mm:g}")] = None
    """Wanted registration error, RMS [mm]."""
    tour: Annotated[Literal["front", "full"] | None, env("TOUR", "front or scene's")] = None
    """Front or all round."""
    lidar_link: Annotated[str | None, env("LIDAR_LINK", "{twin.lidar_link}")] = None
    """Link of the lidar; of urg04lx: usb, 115200 or 115200-full."""
    preset: Annotated[str | None, env("PRESET", "{run.preset}")] = None
    """Named set of options: paper or best."""
    planner: Annotated[str | None, env("PLANNER", "the preset's, {config.planner}")] = None
    """Name (`twin planners`) or module:attribute."""
    seed: Annotated[int | None, env("SEED", "{run.seed}")] = None
    """Random seed; repeats a run of the twin."""
    max_views: Annotated[int | None, env("MAX_VIEWS", "{config.max_views}")] = None
    """Stop after this number of views."""
    optimize_for: Annotated[
        Literal["speed", "memory"] | None,
        env("OPTIMIZE_FOR", "{config.optimize_for}; memory for twin real"),
    ] = None
    """Save time or memory; same results."""
    target: Annotated[
        str | None,
        env("TARGET", "most salient"),
        Parameter(allow_leading_hyphen=True),
    ] = None
    """x,y [m]; twin: body or geom."""
    targets: int | None = None
    """Number of things to scan, each into OUT/target-K."""
    config: Annotated[Path | None, env("CONFIG")] = None
    """TOML file; TWIN_* and the command line override it."""
    out: Annotated[Path | None, env("OUT", "runs/SCENE-TIME")] = None
    """New folder for results."""
    resume: Path | None = None
    """Run to continue; options given now override its own."""
    json: bool = False
    """Print only the report, as JSON, on standard output."""


@dataclass(frozen=True, kw_only=True)
class PortOptions:
    """What the robot is made of, and where it is plugged in."""

    robot: Annotated[str | None, env("ROBOT", "create1 or create2, by its answers")] = None
    """Name of the base (`twin devices`)."""
    lidar: Annotated[str | None, env("LIDAR", "{twin.lidar_model}")] = None
    """Name of the lidar (`twin devices`); twin real also takes auto: the one that is plugged in."""
    port: Annotated[str | None, env("PORT", "by its USB id")] = None
    """Serial port of the base."""
    lidar_port: Annotated[str | None, env("LIDAR_PORT", "by its USB id")] = None
    """Serial port of the lidar."""


def stated_options(options: RunOptions, sections: Options) -> Options:
    """Return what the file, the dotted ``sections`` and the flat ``options`` state, merged."""
    file = {} if options.config is None else read_settings(options.config)
    return merge_options([file, sections, _flat(options, sections)])


_RUN_OPTIONS = (
    "seed", "preset", "world", "target", "mesh_scale", "mesh_up", "room", "keyframe",
)  # fmt: skip
"""Options that are fields of the table ``run``."""
_TOP_OPTIONS = (
    "tour", "planner", "max_views", "optimize_for", "robot", "pattern", "turntable", "lidar_link",
)  # fmt: skip
"""Options that are fields of ``Config`` or ``TwinConfig``."""


def _flat(options: RunOptions, sections: Options) -> Options:
    """Return the flat options where they belong in a configuration, in SI units."""
    run, top = {}, {}
    for name, value in _given(options):
        if name == "scene":
            run[name] = absolute_scene(value)
        elif name in _RUN_OPTIONS:
            run[name] = value
        elif name in _TOP_OPTIONS:
            top[name] = value
        elif name == "lidar":
            top["lidar_model"] = value
        elif name == "base":
            top["robot"] = choose_base(top.get("robot"), value)
    planning = {}
    if options.epsilon is not None:
        if "epsilon" in sections.get("planning", {}):
            raise ConfigError("--epsilon [mm] and --planning.epsilon [m] are the same; give one")
        planning["epsilon"] = options.epsilon / 1e3
    return {**top, "run": run, "planning": planning}


def choose_base(robot: str | None, base: str | None) -> str | None:
    """Return the base that ``--robot`` or ``--base`` names; None where neither does.

    Raises:
        ConfigError: They name two.
    """
    if robot is not None and base is not None and robot != base:
        raise ConfigError(f"--robot {robot} and --base {base} are the same; give one")
    return robot if base is None else base


def _given(options: RunOptions) -> Iterator[tuple[str, Any]]:
    for field in fields(options):
        value = getattr(options, field.name)
        if value is not None:
            yield field.name, value
