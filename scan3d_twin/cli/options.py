"""The options that every scan has, and how they become settings.

No postponed annotations here: those of inherited fields are looked up where the child is defined.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from scan3d_twin.cli.dotted import ENVIRONMENT
from scan3d_twin.core.errors import ConfigError
from scan3d_twin.run.settings import Options, absolute_scene, merge, read_settings


def env(name: str) -> Parameter:
    """Return a parameter that the variable TWIN_``name`` sets too."""
    return Parameter(env_var=ENVIRONMENT + name)


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """The options people use most; None is not stated."""

    epsilon: Annotated[float | None, env("EPSILON")] = None
    """Wanted registration error, root mean square [mm] (default 10)."""
    tour: Annotated[Literal["front", "full"] | None, env("TOUR")] = None
    """Scan the front only, or all round (default: the scene's, or front)."""
    lidar_link: Annotated[str | None, env("LIDAR_LINK")] = None
    """Link of the lidar: usb (682 steps, 10 Hz), 115200 (357 steps, 10 Hz) or 115200-full
    (682 steps, 5 Hz) (default usb)."""
    planner: Annotated[str | None, env("PLANNER")] = None
    """Name of the planner, see `twin planners` (default: the preset's)."""
    preset: Annotated[str | None, env("PRESET")] = None
    """Named set of options: paper or best (default paper)."""
    seed: Annotated[int | None, env("SEED")] = None
    """The run's one seed; in the twin the same seed gives the same files (default 0)."""
    max_views: Annotated[int | None, env("MAX_VIEWS")] = None
    """Stop after this many views (default 20)."""
    optimize_for: Annotated[Literal["speed", "memory"] | None, env("OPTIMIZE_FOR")] = None
    """What this computer has least of; the results are the same (default: time; memory for the
    real robot)."""
    target: Annotated[str | None, Parameter(env_var="TWIN_TARGET", allow_leading_hyphen=True)] = (
        None
    )
    """What to scan: its place x,y in the odometry frame [m], or in the twin a target's name
    (default: what stands out)."""
    targets: int | None = None
    """Scan this many things one after the other, what stands out most first, each into its own
    folder target-0, target-1, ... of --out."""
    config: Annotated[Path | None, env("CONFIG")] = None
    """TOML file with options; the command line and the environment win over it."""
    out: Annotated[Path | None, env("OUT")] = None
    """Folder for the results, new or empty (default runs/SCENE-TIME)."""
    resume: Path | None = None
    """Folder of a run to go on with, from its last finished view; the options stated now win over
    its own."""
    json: bool = False
    """Print the report, and nothing else, on standard output."""


@dataclass(frozen=True, kw_only=True)
class PortOptions:
    """What the robot is made of, and where it is plugged in."""

    robot: Annotated[str | None, env("ROBOT")] = None
    """Name of the base, see `twin devices`; create2 finds a Create 1 as well (default create2)."""
    lidar: Annotated[str | None, env("LIDAR")] = None
    """Name of the lidar, see `twin devices` (default: the one of the paper)."""
    port: Annotated[str | None, env("PORT")] = None
    """Serial port of the base, such as /dev/ttyUSB0 (default: found by its USB id)."""
    lidar_port: Annotated[str | None, env("LIDAR_PORT")] = None
    """Serial port of the lidar, such as /dev/ttyACM0 (default: found by its USB id)."""


def stated_options(options: ScanOptions, sections: Options) -> Options:
    """Return what the file, the dotted ``sections`` and the flat ``options`` state, merged."""
    file = {} if options.config is None else read_settings(options.config)
    return merge([file, sections, _flat(options, sections)])


def _flat(options: ScanOptions, sections: Options) -> Options:
    """Return the flat options where they belong in a configuration, in SI units."""
    run, top = {}, {}
    for name, value in _given(options):
        if name == "scene":
            run[name] = absolute_scene(value)
        elif name in ("seed", "preset", "world", "target", "mesh_scale"):
            run[name] = value
        elif name in ("tour", "planner", "max_views", "optimize_for", "robot", "lidar_link"):
            top[name] = value
        elif name == "lidar":
            top["lidar_model"] = value
    planning = {}
    if options.epsilon is not None:
        if "epsilon" in sections.get("planning", {}):
            raise ConfigError("--epsilon [mm] and --planning.epsilon [m] are the same; give one")
        planning["epsilon"] = options.epsilon / 1e3
    return {**top, "run": run, "planning": planning}


def _given(options: ScanOptions) -> Iterator[tuple[str, Any]]:
    for field in fields(options):
        value = getattr(options, field.name)
        if value is not None:
            yield field.name, value
