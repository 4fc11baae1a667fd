"""All options of a run: merged from their sources, checked, and written to run it again.

Sources are nested mappings in the shape of the TOML file: the fields of ``Config`` and
``TwinConfig`` by name, sections as tables, and the table ``run`` with the fields of ``RunConfig``.
A field whose name Python reserves (``lambda_``) is spelled without its underscore.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import tomli_w

from scan3d_twin import __version__
from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.core.options import check_options, former_names, number, option_key
from scan3d_twin.core.presets import DEFAULT_PRESET
from scan3d_twin.devices.registry import Devices, base_device, lidar_device
from scan3d_twin.run.toml import read_toml
from scan3d_twin.sim.config import DEFAULT_WORLD, WORLDS, RobotErrorConfig, TwinConfig, find_fixed
from scan3d_twin.sim.lidar.config import LidarModelConfig
from scan3d_twin.sim.mesh_up import parse_mesh_up
from scan3d_twin.sim.room import DEFAULT_ROOM, parse_room

Options = Mapping[str, Any]
REAL_SCENE = "real"
"""The scene's name in a run of the real robot; no scene has this name."""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class RunConfig:
    """What is scanned, and with which seed and named sets of options."""

    scene: str = "three_boxes"
    """Name of a built-in scene, or path of an .xml or mesh file."""
    seed: int = number(0, 0, 2**63 - 1)
    """The run's one seed."""
    preset: str = DEFAULT_PRESET
    """Named set of options."""
    world: str = DEFAULT_WORLD
    """Named set of the twin's errors: ideal, typical, harsh or unfiltered."""
    target: str = ""
    """Name of a body or geom of the scene, or x,y [m] in the odometry frame; empty: the most
    salient."""
    keyframe: str = ""
    """Keyframe at which the joints of an .xml file are frozen; empty: their reference pose."""
    mesh_scale: float = number(1.0, most=1e6)
    """Metres per unit of a mesh file."""
    room: str = DEFAULT_ROOM
    """Room around a mesh file: width x depth [m], or none for an open floor."""
    mesh_up: str = "auto"
    """Axis of a mesh file that is up: y, z, or auto: y in glTF, else guessed."""
    version: str = __version__
    """Version of the software that wrote the options."""

    def __post_init__(self) -> None:
        check_options(self, "run")
        parse_room(self.room)
        parse_mesh_up(self.mesh_up)
        if self.world not in WORLDS:
            raise UnknownNameError("world", self.world, WORLDS)


@dataclass(frozen=True, slots=True)
class Settings:
    """The effective configuration of a run."""

    run: RunConfig = field(default_factory=RunConfig)
    config: Config = field(default_factory=Config)
    twin: TwinConfig = field(default_factory=TwinConfig)


def merge_options(sources: Iterable[Options]) -> dict[str, Any]:
    """Return all ``sources`` as one mapping; later ones win, table by table."""
    merged: dict[str, Any] = {}
    for source in sources:
        for name, value in source.items():
            if isinstance(value, Mapping) and isinstance(merged.get(name, {}), Mapping):
                value = merge_options([merged.get(name, {}), value])
            merged[name] = value
    return merged


def build_settings(sources: Iterable[Options]) -> Settings:
    """Return the settings that ``sources`` state; later ones win, the rest are defaults.

    Raises:
        ConfigError: A key is unknown, or a value is of the wrong type or out of range.
    """
    options = merge_options(sources)
    for name in options:
        if name not in former_names(Config):
            _check_known(name, _known_keys())
    return Settings(
        run=_build(RunConfig, options.get("run", {}), "run."),
        config=_build(Config, _select_options(options, Config), ""),
        twin=_build(TwinConfig, _select_options(options, TwinConfig), ""),
    )


def world_options(name: str) -> Options:
    """Return the options that the twin's named world fixes, whatever devices state."""
    lidar, errors = WORLDS[name]
    return {"lidar": _take_fixed(lidar), "errors": _take_fixed(errors)}


def _take_fixed(errors: LidarModelConfig | RobotErrorConfig) -> Options:
    """Return the fields that ``errors`` of a world fix, by key."""
    fixed = {option_key(name) for name in find_fixed(errors)}
    return {name: each for name, each in _to_plain(errors).items() if name in fixed}


def device_options(devices: Devices) -> Options:
    """Return the options that the robot's base and lidar stand for."""
    return merge_options([base_device(devices.base).options, lidar_device(devices.lidar).options])


def read_settings(path: Path) -> Options:
    """Return the options in the TOML file ``path``, unchecked.

    Raises:
        FileError: It is missing, unreadable or not TOML.
    """
    return read_toml(path)


def settings_toml(effective: Settings) -> str:
    """Return ``effective`` as a TOML file that ``read_settings`` reads back."""
    tables = {
        **_to_plain(effective.config),
        **_to_plain(effective.twin),
        "run": _to_plain(effective.run),
    }
    ordered = sorted(tables.items(), key=lambda item: isinstance(item[1], dict))
    command = "real" if effective.run.scene == REAL_SCENE else "sim"
    return f"# Run again: twin {command} --config THIS_FILE\n" + tomli_w.dumps(dict(ordered))


def _select_options(options: Options, cls: type) -> dict[str, Any]:
    names = {option_key(f.name) for f in fields(cls)} | set(former_names(cls))
    return {name: value for name, value in options.items() if name in names}


def _known_keys() -> list[str]:
    return ["run", *(option_key(f.name) for cls in (Config, TwinConfig) for f in fields(cls))]


def _check_known(name: str, known: list[str], where: str = "") -> None:
    if name in known:
        return
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {where}{near[0]}? " if near else ""
    raise ConfigError(f"no key {where}{name}; {hint}known: {', '.join(sorted(known))}")


def _build(cls: type[T], values: Any, where: str) -> T:
    """Return ``cls`` with ``values`` by key, checked; ``where`` is their prefix in messages."""
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where.rstrip('.')} must be a table, got {values!r}")

    # Collect fields and former names
    names = {option_key(f.name): f.name for f in fields(cls)}  # type: ignore[arg-type]
    hints, former = get_type_hints(cls), former_names(cls)
    arguments: dict[str, Any] = {}

    # Check and convert each value
    for name, value in values.items():
        if name not in former:
            _check_known(name, list(names), where)
        field_name, renames = former.get(name) or (names[name], {})
        hint = hints[field_name]
        if is_dataclass(hint):
            arguments[field_name] = _build(hint, value, f"{where}{name}.")  # type: ignore[arg-type]
        else:
            value = renames.get(value, value) if isinstance(value, str) else value
            arguments[field_name] = _to_float(value) if _is_whole(value, hint) else value
    return cls(**arguments)


def _to_float(value: Any) -> float:
    """Return a whole number as a float; infinite, which no option may be, beyond all floats."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _is_whole(value: Any, hint: Any) -> bool:
    """Return whether ``value`` is a whole number where the hint asks for a float."""
    return hint is float and isinstance(value, int) and not isinstance(value, bool)


def _to_plain(value: Any) -> Any:
    if is_dataclass(value):
        return {option_key(f.name): _to_plain(getattr(value, f.name)) for f in fields(value)}
    return value


def absolute_scene(scene: str) -> str:
    """Return the path of a scene file so that it is found from any folder; a name as it is."""
    path = Path(scene)
    return str(path.resolve()) if path.suffix and path.is_file() else scene


NAME_OR_PLACE = "a name or x,y in metres"
"""The forms in which a target of the twin can be stated."""


def parse_place(text: str, choice: str) -> tuple[float, float]:
    """Return the place (x, y) [m] that ``text`` states as x,y.

    Raises:
        ConfigError: ``text`` is no place; the message names the ``choice`` of forms.
    """
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError(f"the target must be {choice}, got {text!r}") from None
    return x, y
