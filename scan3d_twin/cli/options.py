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
class BaseName:
    """The other name of an option ``robot``, which is the one that is read."""

    base: Annotated[str | None, Parameter(show=False)] = None
    """Another name of ``--robot``: a stand is none."""

    def __post_init__(self) -> None:
        robot = getattr(self, "robot", None)
        if robot is not None and self.base is not None and robot != self.base:
            raise ConfigError(f"--robot {robot} and --base {self.base} are the same; give one")
        object.__setattr__(self, "robot", self.base if robot is None else robot)
        object.__setattr__(self, "base", None)


@dataclass(frozen=True, kw_only=True)
class TurntableOptions(BaseName):
    """What turns the lidar; None is not stated."""

    pattern: Annotated[Pattern | None, env("PATTERN")] = None
    """How the lidar is turned."""
    turntable: Annotated[str | None, env("TURNTABLE"), Parameter(show=False)] = None
    """Name of the turntable: xl330 or ideal."""


@dataclass(frozen=True, kw_only=True)
class SceneOptions(BaseName):
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
class PortOptions(BaseName):
    """What the robot is made of, and where it is plugged in."""

    robot: Annotated[str | None, env("ROBOT", "by its answers")] = None
    """Name of the base (`twin devices`)."""
    lidar: Annotated[str | None, env("LIDAR", "{twin.lidar_model}")] = None
    """Name of the lidar (`twin devices`); twin real: or auto."""
    port: Annotated[str | None, env("PORT", "by its USB id")] = None
    """Serial port of the base."""
    lidar_port: Annotated[str | None, env("LIDAR_PORT", "by its USB id")] = None
    """Serial port of the lidar."""
    pattern: Annotated[Pattern | None, env("PATTERN", "yaw-base")] = None
    """Base or table turns the lidar."""
    turntable: Annotated[str | None, env("TURNTABLE", "none")] = None
    """Name of the turntable (`twin devices`)."""
    turntable_port: Annotated[str | None, env("TURNTABLE_PORT", "by its USB id")] = None
    """Its serial port."""


def stated_options(options: RunOptions, sections: Options) -> Options:
    """Return what the file, the dotted ``sections`` and the flat ``options`` state, merged."""
    file = {} if options.config is None else read_settings(options.config)
    merged = merge_options([file, sections, _flat(options, sections)])
    # A run that goes on knows its pattern
    if "pattern" in merged or options.resume is not None or not names_turntable(options):
        return merged
    return {**merged, "pattern": TURNTABLE_PATTERN}


TURNTABLE_PATTERN: Pattern = "yaw"
"""Pattern of a turntable that is named without one."""


def names_turntable(options: object) -> bool:
    """Return whether ``options`` name a turntable or its port."""
    named = (getattr(options, name, None) for name in ("turntable", "turntable_port"))
    return any(each is not None for each in named)


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
    planning = {}
    if options.epsilon is not None:
        if "epsilon" in sections.get("planning", {}):
            raise ConfigError("--epsilon [mm] and --planning.epsilon [m] are the same; give one")
        planning["epsilon"] = options.epsilon / 1e3
    return {**top, "run": run, "planning": planning}


def _given(options: RunOptions) -> Iterator[tuple[str, Any]]:
    for field in fields(options):
        value = getattr(options, field.name)
        if value is not None:
            yield field.name, value
