"""Waiting times of a user: for help, for the first line, and for a whole run, first or repeated.

Each figure is a median, taken by turns with its peer: cyclopts, bare Python, or the checkout in
another folder. Wall time, but for ``sim_vs``, which takes the processor time of whole processes;
bytecode is kept as on a user's computer. The clones need the packages in the cache of pip and uv.

Run: .venv/bin/python benchmarks/startup.py [--only NAME ...] [--against FOLDER] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

ROOT = Path(__file__).resolve().parents[1]
SCENE = ("sim", "--scene", "three_boxes")
REPEATS = 20
"""Of what takes a fraction of a second, after one to warm up."""
ENVIRONMENT = {
    **{name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}


@dataclass(frozen=True)
class Figure:
    """One result.

    Attributes:
        value: The figure.
        unit: Its unit; ``x`` is a ratio of medians, or the median of ratios of pairs.
        peer: What it is measured against.
        runs: How often each side ran.
    """

    value: float
    unit: str
    peer: str
    runs: int


Command = Sequence[str | Path]


def wall(command: Command, folder: Path = ROOT) -> float:
    """Run ``command`` and return how long it took [s]."""
    started = time.perf_counter()
    subprocess.run(command, cwd=folder, env=ENVIRONMENT, check=True, capture_output=True)
    return time.perf_counter() - started


def cpu(command: Command, folder: Path) -> float:
    """Run ``command`` and return the processor time of its whole process [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    wall(command, folder)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def python(program: str) -> Command:
    return [ROOT / ".venv/bin/python", "-c", program]


def twin(folder: Path) -> Path:
    return folder / ".venv/bin/twin"


def by_turns(ours: Command, peer: Command) -> tuple[float, float]:
    """Return the medians of both commands, run by turns, after one run each to warm up [s]."""
    times = [(wall(ours), wall(peer)) for _ in range(1 + REPEATS)][1:]
    return median(one for one, _ in times), median(other for _, other in times)


def help_over_cyclopts() -> Figure:
    """``twin --help`` against the import of the library that parses its options."""
    ours, peer = by_turns([twin(ROOT), "--help"], python("import cyclopts"))
    return Figure(ours / peer, "x", "python -c 'import cyclopts'", REPEATS)


def import_over_bare_ms() -> Figure:
    """The import of the package, less what Python itself takes."""
    ours, peer = by_turns(python("import scan3d_twin"), python("pass"))
    return Figure(1e3 * (ours - peer), "ms", "python -c pass", REPEATS)


def first_line_s() -> Figure:
    """From the start of ``twin sim`` to the first line that it says."""
    times = [_first_line() for _ in range(1 + REPEATS // 2)][1:]
    return Figure(median(times), "s", "none", len(times))


def _first_line() -> float:
    with tempfile.TemporaryDirectory() as folder:
        command = [twin(ROOT), *SCENE, "--out", Path(folder) / "run"]
        started = time.perf_counter()
        with subprocess.Popen(
            command, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            taken = time.perf_counter() - started
            process.kill()
    return taken


def cold_over_warm() -> Figure:
    """The first run after ``make setup`` against the two after it."""
    with cloned(ROOT) as folder:
        wall(["make", "setup"], folder)
        first, *later = (wall([twin(folder), *SCENE], folder) for _ in range(3))
    return Figure(first / median(later), "x", "the next two runs", 1)


def demo_vs(against: Path) -> Figure:
    """``make demo`` in a fresh clone, set-up included, against that of another checkout."""
    times = []
    for source in (ROOT, against):
        with cloned(source) as folder:
            times.append(wall(["make", "demo"], folder))
    return Figure(times[0] / times[1], "x", str(against), 1)


def sim_vs(against: Path, seeds: int) -> Figure:
    """Processor time per view of a warm run, against that of another checkout, seed by seed."""
    _per_view(ROOT, 0), _per_view(against, 0)
    ratios = [_per_view(ROOT, seed) / _per_view(against, seed) for seed in range(seeds)]
    return Figure(median(ratios), "x", str(against), seeds)


def _per_view(source: Path, seed: int) -> float:
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        taken = cpu([twin(source), *SCENE, "--seed", str(seed), "--out", out], source)
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    return taken / int(report["views"])


@contextmanager
def cloned(source: Path) -> Iterator[Path]:
    """Clone the checkout ``source`` at its HEAD into a folder that goes away."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        clone = Path(folder) / "clone"
        wall(["git", "clone", "--quiet", source, clone])
        try:
            yield clone
        finally:
            shutil.rmtree(clone, ignore_errors=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="figures (default: all)")
    parser.add_argument("--against", type=Path, help="checkout with its own .venv for the _vs")
    parser.add_argument("--seeds", type=int, default=10, help="of sim_vs (default 10)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    options = parser.parse_args()

    figures: dict[str, Callable[[], Figure]] = {
        each.__name__: each
        for each in (help_over_cyclopts, import_over_bare_ms, first_line_s, cold_over_warm)
    }
    if options.against is not None:
        against = options.against.resolve()
        figures["sim_vs"] = lambda: sim_vs(against, options.seeds)
        figures["demo_vs"] = lambda: demo_vs(against)
    wanted = options.only or list(figures)
    if unknown := set(wanted) - set(figures):
        parser.error(f"no figure {', '.join(sorted(unknown))}; those of --against need it")

    found = {}
    for name in wanted:
        found[name] = figures[name]()
        if not options.json:
            print(f"{name}: {found[name].value:.3g} {found[name].unit} ({found[name].peer})")
    if options.json:
        print(json.dumps({name: asdict(figure) for name, figure in found.items()}, indent=2))


if __name__ == "__main__":
    main()
