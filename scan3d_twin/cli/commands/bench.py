"""``twin bench``: compare planners on many seeds."""

from __future__ import annotations

import json as json_module
import os
import sys
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import App, Parameter

from scan3d_twin.cli.defaults import default_text
from scan3d_twin.cli.dotted import dotted_options, stated
from scan3d_twin.cli.output import say
from scan3d_twin.core.config import Config
from scan3d_twin.core.errors import ConfigError, ScanError
from scan3d_twin.run.settings import Options, merge_options
from scan3d_twin.sim.config import TwinConfig

if TYPE_CHECKING:
    from scan3d_twin.bench.engine import Engine
    from scan3d_twin.bench.record import Record
    from scan3d_twin.bench.spec import Experiment
    from scan3d_twin.bench.task import Task

    DottedOptions = Any
else:
    DottedOptions = dotted_options(Config, TwinConfig)

app = App(
    name="bench",
    help_format="markdown",
    help="Compare planners on many seeds in the twin: `twin bench --suite smoke`.",
)
Names = Annotated[tuple[str, ...], Parameter(consume_multiple=True)]
SEEDS = 10
"""Seeds of an experiment that the options describe."""


def _shown(default: str) -> Parameter:
    """Return a parameter whose default help pages show as ``default``, see ``default_text``."""
    return Parameter(show_default=lambda _: default_text(default))


@dataclass(frozen=True, kw_only=True)
class BenchOptions:
    """What is run, where and by which workers."""

    suite: str | None = None
    """Experiment of the package: smoke, paper-fig10, paper-fig13, costs, lidars or full."""
    scenes: Annotated[Names, _shown("{run.scene}")] = ()
    """Scenes, by name or file."""
    planners: Annotated[Names, _shown("each preset's own")] = ()
    """Planners (`twin planners`)."""
    presets: Annotated[Names, _shown("{run.preset}")] = ()
    """Presets: paper or best."""
    seeds: Annotated[int | None, _shown(f"{SEEDS}, or the file's")] = None
    """Number of seeds, the same ones for all planners."""
    first_seed: Annotated[int | None, _shown("0, or the file's")] = None
    """The first seed."""
    epsilon: Annotated[float | None, _shown("{epsilon_mm:g}")] = None
    """Wanted registration error of all runs, root mean square [mm]."""
    tour: Annotated[Literal["front", "full"] | None, _shown("front, or the scene's own")] = None
    """Scan the front or all round."""
    max_views: Annotated[int | None, _shown("{config.max_views}")] = None
    """Stop each run after this number of views."""
    world: Annotated[str | None, _shown("{run.world}")] = None
    """Twin's errors: ideal, typical, harsh, unfiltered."""
    jobs: Annotated[int | None, _shown("one per processor")] = None
    """Workers on this computer."""
    timeout: float = 900.0
    """Limit of a run, which is then tried again, twice at most [s]."""
    cluster: str | None = None
    """Scheduler of a Dask cluster whose workers do the runs, such as tcp://10.0.0.1:8786."""
    shard: str | None = None
    """Do one part of the runs only, such as 2/8; the parts may share the folder."""
    out: Annotated[Path | None, _shown("runs/bench-NAME")] = None
    """Folder for journal, results and top views; runs that are in it are not repeated."""
    json: bool = False
    """Print the figures as one JSON document."""


@app.default
def bench(
    file: Path | None = None,
    /,
    *,
    options: Annotated[BenchOptions, Parameter(name="*")] = BenchOptions(),
    dotted: Annotated[DottedOptions | None, Parameter(name="*")] = None,
) -> None:
    """Compare planners on many seeds in the twin.

    The experiment is a TOML file (docs/bench.md), a --suite, or given by --scenes, --planners and
    --presets. Each run is written to a journal as it ends; when the bench was stopped, the same
    command continues with the runs that are missing. Dotted options apply to all runs.

    Args:
        file: Experiment as a TOML file (docs/bench.md).
        options: What is run, where and by which workers.
        dotted: Configuration in SI units and radians.

    Raises:
        TwinError: An option is wrong, a file cannot be written, or runs were lost.
    """
    from scan3d_twin.bench.spec import list_tasks, select_shard

    common = _common(options, {} if dotted is None else stated(dotted))
    experiment = _experiment(file, options).with_options(common)
    number, count = shard = _shard(options.shard)
    folder = options.out or Path("runs") / f"bench-{experiment.name}"
    _require_store()
    chosen = select_shard(list_tasks(experiment), number, count)
    records = _run(chosen, shard, folder, options)
    _print_figures(records, folder, as_json=options.json)
    lost = sum(record.status == "lost" for record in records)
    if lost:
        raise ScanError(f"{lost} runs were lost, see {folder}; repeat the command to retry them")


def _run(
    chosen: list[Task], shard: tuple[int, int], folder: Path, options: BenchOptions
) -> list[Record]:
    """Run what is left of the ``chosen`` tasks; return all records of the folder."""
    from scan3d_twin.bench.execute import execute_tasks, find_open_tasks
    from scan3d_twin.bench.journal import Journal, journal_path
    from scan3d_twin.bench.store import RESULTS_FILE, collect_records, write_parquet
    from scan3d_twin.cli.bench_progress import bench_progress

    with Journal(journal_path(folder, shard)) as journal:
        todo = find_open_tasks(chosen, folder)
        left = len(todo)
        with bench_progress(len(chosen), len(chosen) - left) as progress:
            try:
                if todo:
                    with _engine(options) as engine:
                        execute_tasks(todo, engine, journal, folder, progress.done)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"interrupted; {progress.count} of {len(chosen)} runs are in {folder}; repeat "
                    "the command to continue"
                ) from None
        records = collect_records(folder)
        write_parquet(records, folder / RESULTS_FILE)
    return records


def _experiment(file: Path | None, options: BenchOptions) -> Experiment:
    """Return what is to be run."""
    from scan3d_twin.bench.spec import load_suite, make_experiment, read_experiment

    given = bool(options.scenes or options.planners or options.presets)
    if (file is not None) + (options.suite is not None) + given > 1:
        raise ConfigError("give one of FILE, --suite, and --scenes/--planners/--presets")
    if options.suite is not None:
        found = load_suite(options.suite)
    elif file is not None:
        found = read_experiment(file)
    elif given:
        found = make_experiment(
            options.scenes or ("three_boxes",), options.planners, options.presets or ("best",)
        ).with_seeds(SEEDS, 0)
    else:
        raise ConfigError("no experiment: give a FILE, --suite smoke, or --planners NAME ...")
    return found.with_seeds(options.seeds, options.first_seed)


def _common(options: BenchOptions, sections: Options) -> Options:
    """Return what is stated for all runs, in the shape of a configuration file."""
    top = {"tour": options.tour, "max_views": options.max_views}
    flat: dict[str, Any] = {name: value for name, value in top.items() if value is not None}
    if options.world is not None:
        flat["run"] = {"world": options.world}
    if options.epsilon is not None:
        flat["planning"] = {"epsilon": options.epsilon / 1e3}
    return merge_options([flat, sections])


def _engine(options: BenchOptions) -> AbstractContextManager[Engine]:
    """Return what opens the workers."""
    if not options.timeout > 0:
        raise ConfigError(f"--timeout must be > 0 s, got {options.timeout:g}")
    if options.cluster is not None:
        from scan3d_twin.bench.cluster import cluster_engine

        if options.jobs is not None:
            raise ConfigError("--jobs is for this computer; a --cluster has its own workers")
        return cluster_engine(options.cluster, options.timeout)
    from scan3d_twin.bench.local import local_engine

    jobs = len(os.sched_getaffinity(0)) if options.jobs is None else options.jobs
    if jobs < 1:
        raise ConfigError(f"--jobs must be >= 1, got {jobs}")
    return local_engine(jobs, options.timeout)


def _shard(text: str | None) -> tuple[int, int]:
    """Return number, from 1, and count of the part that ``text`` states."""
    if text is None:
        return 1, 1
    number, _, count = text.partition("/")
    if number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count):
        return int(number), int(count)
    raise ConfigError(f"--shard must be NUMBER/COUNT from 1/COUNT on, such as 2/8; got {text!r}")


def _require_store() -> None:
    """Raise before hours of computing if the results could not be stored at their end."""
    from importlib.util import find_spec

    if find_spec("duckdb") is None:
        raise ConfigError("DuckDB is not installed: pip install duckdb pebble")


def _print_figures(records: list[Record], folder: Path, *, as_json: bool) -> None:
    """Print the figures of all records in ``folder``."""
    from scan3d_twin.bench.reporting.measures import format_table, rows_as_dicts, summarise
    from scan3d_twin.bench.store import RESULTS_FILE
    from scan3d_twin.cli.bench_table import fold_table

    rows = summarise(records)
    if as_json:
        document = {"folder": str(folder), "runs": len(records), "figures": rows_as_dicts(rows)}
        print(json_module.dumps(document, indent=2, allow_nan=False))
        return
    say("\n".join(fold_table(format_table(rows), get_terminal_size().columns)), sys.stdout)
    print("\n[low, high]: 95 % intervals")
    say(f"{folder}: {RESULTS_FILE} journal top_views/", sys.stdout)
    say(f"twin bench report {folder}: a page with figures", sys.stdout)
    codes = {record.code for record in records if record.code}
    if len(codes) > 1:
        print(f"do not quote these figures: the runs used {len(codes)} versions of the sources")


@app.command
def report(
    path: Path, /, *, out: Annotated[Path | None, _shown("PATH/report")] = None, json: bool = False
) -> None:
    """Make a page of tables and figures from the results of a bench.

    Writes report.html, which works offline, and each figure as SVG and each table as CSV.

    Args:
        path: Folder of a bench, or its results.parquet.
        out: Folder for the report.
        json: Print the figures and the comparisons as one JSON document.

    Raises:
        TwinError: There are no results, or the folder cannot be written.
    """
    from scan3d_twin.bench.record import replace_nonfinite
    from scan3d_twin.bench.reporting.compare import compare_variants, compare_with_oracle
    from scan3d_twin.bench.reporting.files import write_report
    from scan3d_twin.bench.reporting.measures import rows_as_dicts, summarise
    from scan3d_twin.bench.store import read_results
    from scan3d_twin.run.folder import readable

    records = read_results(path)
    folder = path if path.is_dir() else path.parent
    title = f"{readable(folder.resolve().name)}: planners on the same seeds"
    written = write_report(records, title, folder, out or folder / "report")
    if json:
        document = {
            "report": str(written),
            "figures": rows_as_dicts(summarise(records)),
            "comparisons": [asdict(each) for each in compare_variants(records)],
            "regrets": [asdict(each) for each in compare_with_oracle(records)],
        }
        print(json_module.dumps(replace_nonfinite(document), indent=2, allow_nan=False))
    else:
        say(str(written), sys.stdout)
