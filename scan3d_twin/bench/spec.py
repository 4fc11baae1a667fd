"""Experiments: variants of the options, and grids of scenes, variants and seeds.

As a TOML file::

    description = "two planners on two scenes"
    options.max_views = 12            # for every run, in the shape of a configuration file

    [variants.best]                   # a set of options with a name
    run.preset = "best"

    [variants.fixed50]
    planner = "fixed50"
    registration.scope = "target"

    [[grids]]                         # scenes x variants x seeds
    scenes = ["three_boxes", "sine_box"]
    variants = ["best", "fixed50"]    # default: all
    seeds = 30
    first_seed = 0                    # default

All variants run with the same seeds, which give the same robots and the same noise, so that their
differences are paired.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

from scan3d_twin.bench.task import Task
from scan3d_twin.core.errors import ConfigError, UnknownNameError
from scan3d_twin.run.resolve import resolve_sim
from scan3d_twin.run.settings import Options, merge_options, read_settings

SUITES = files("scan3d_twin.bench") / "suites"


@dataclass(frozen=True)
class Grid:
    """The product of scenes, variants and seeds.

    Attributes:
        scenes: Names or files of scenes.
        variants: Names of variants.
        seeds: Consecutive seeds.
    """

    scenes: tuple[str, ...]
    variants: tuple[str, ...]
    seeds: range


@dataclass(frozen=True)
class Experiment:
    """An experiment of ``twin bench``.

    Attributes:
        name: Name, also of the default folder.
        description: One line.
        variants: Options by the name of the variant.
        grids: The runs.
    """

    name: str
    description: str
    variants: Mapping[str, Options]
    grids: tuple[Grid, ...]

    def with_seeds(self, count: int | None, first: int | None) -> Experiment:
        """Return the experiment with another number or first of seeds; None keeps it."""
        grids = []
        for grid in self.grids:
            start = grid.seeds.start if first is None else first
            grids.append(
                replace(grid, seeds=_seeds(len(grid.seeds) if count is None else count, start))
            )
        return replace(self, grids=tuple(grids))

    def with_options(self, options: Options) -> Experiment:
        """Return the experiment with ``options`` over those of every variant."""
        variants = {name: merge_options([own, options]) for name, own in self.variants.items()}
        return replace(self, variants=variants)


def list_tasks(experiment: Experiment) -> list[Task]:
    """Return the tasks of ``experiment``, seed by seed, so that a partial run is paired.

    Raises:
        ConfigError, SceneError: A scene, variant or option is wrong.
    """
    rows: dict[str, tuple[tuple[int, int], Task]] = {}
    for number, grid in enumerate(experiment.grids):
        for scene, variant in product(grid.scenes, grid.variants):
            first = _task(scene, variant, experiment.variants)
            for seed in grid.seeds:
                task = first.with_seed(seed, picture=seed == grid.seeds.start)
                rows.setdefault(task.key, ((seed - grid.seeds.start, number), task))
    return [task for _, task in sorted(rows.values(), key=lambda row: row[0])]


def select_shard(whole: Sequence[Task], number: int, count: int) -> list[Task]:
    """Return shard ``number`` (from 1) of ``count``: every ``count``-th task of the ``whole``."""
    return list(whole[number - 1 :: count])


def _task(scene: str, variant: str, variants: Mapping[str, Options]) -> Task:
    path = Path(scene)
    found = str(path.resolve()) if path.suffix and path.is_file() else scene
    given = merge_options([variants[variant], {"run": {"scene": found}}])
    try:
        settings, loaded = resolve_sim(given)
    except ConfigError as error:
        raise ConfigError(f"variant {variant!r} on {scene}: {error}") from error
    return Task(loaded.name, variant, settings)


def suite_names() -> tuple[str, ...]:
    """Return the names of the experiments that come with the package."""
    return tuple(
        sorted(
            each.name.removesuffix(".toml")
            for each in SUITES.iterdir()
            if each.name.endswith(".toml")
        )
    )


def load_suite(name: str) -> Experiment:
    """Return the experiment ``name`` that comes with the package.

    Raises:
        UnknownNameError: There is no such experiment.
    """
    if name not in suite_names():
        raise UnknownNameError("suite", name, suite_names())
    return read_experiment(Path(str(SUITES / f"{name}.toml")))


def read_experiment(path: Path) -> Experiment:
    """Return the experiment in the TOML file ``path``.

    Raises:
        FileError: The file cannot be read.
        ConfigError: A key or value is wrong.
    """
    # Read the variants
    document = read_settings(path)
    where = str(path)
    _check_keys(document, ("description", "options", "variants", "grids"), where)
    common = _table(document, "options", where)
    own = {
        name: merge_options([common, _table(document["variants"], name, f"{where}: variants")])
        for name in _table(document, "variants", where)
    }

    # Read the grids
    grids = document.get("grids", [])
    if not own or not isinstance(grids, list) or not grids:
        raise ConfigError(f"{where} needs [variants.NAME] and [[grids]]")
    return Experiment(
        name=path.stem,
        description=str(document.get("description", "")),
        variants=own,
        grids=tuple(_grid(grid, own, where) for grid in grids),
    )


def make_experiment(
    scenes: Sequence[str], planners: Sequence[str], presets: Sequence[str]
) -> Experiment:
    """Return an experiment of planners x presets on ``scenes``; by default the preset's planner."""
    variants: dict[str, Options] = {}
    for preset, planner in product(presets, planners or [""]):
        options: dict[str, Any] = {"run": {"preset": preset}}
        name = preset
        if planner:
            options["planner"] = planner
            name = planner if len(presets) == 1 else f"{planner}-{preset}"
        variants[name] = options
    grid = Grid(tuple(scenes), tuple(variants), _seeds(1, 0))
    return Experiment("own", "", variants, (grid,))


def _grid(grid: Any, variants: Mapping[str, Options], where: str) -> Grid:
    if not isinstance(grid, Mapping):
        raise ConfigError(f"{where}: [[grids]] must be tables")
    _check_keys(grid, ("scenes", "variants", "seeds", "first_seed"), f"{where}: grids")
    names = _names(grid.get("variants", list(variants)), f"{where}: grids.variants")
    for name in names:
        if name not in variants:
            raise UnknownNameError("variant", name, variants)
    scenes = _names(grid.get("scenes", []), f"{where}: grids.scenes")
    return Grid(scenes, names, _seeds(grid.get("seeds", 1), grid.get("first_seed", 0)))


def _seeds(count: Any, first: Any) -> range:
    if not isinstance(count, int) or count < 1:
        raise ConfigError(f"seeds must be a whole number >= 1, got {count!r}")
    if not isinstance(first, int) or first < 0:
        raise ConfigError(f"first_seed must be a whole number >= 0, got {first!r}")
    return range(first, first + count)


def _names(value: Any, where: str) -> tuple[str, ...]:
    if isinstance(value, list) and value and all(isinstance(each, str) for each in value):
        return tuple(value)
    raise ConfigError(f"{where} must be a list of names, got {value!r}")


def _table(document: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    value = document.get(name, {})
    if not isinstance(value, Mapping):
        raise ConfigError(f"{where}: {name} must be a table, got {value!r}")
    return value


def _check_keys(document: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    for name in document:
        if name not in known:
            near = difflib.get_close_matches(name, list(known), n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise ConfigError(f"{where}: no key {name}{hint} known: {', '.join(known)}")
