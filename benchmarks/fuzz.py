"""Damaged and odd files: each must end in one line, within 5 s and 1 GB.

    python benchmarks/fuzz.py 10000            # inputs over all kinds, seed 1
    python benchmarks/fuzz.py 500 toml npz     # of these kinds
    python benchmarks/fuzz.py 200 recover      # single faults of a session of three views
    python benchmarks/fuzz.py 10000 --log FILE # outcomes go there; again, it goes on after them

Each input is a right file with random changes, written anew where the format has checksums, so
that the change reaches the reader. It is read in a child; the child's processor time and memory are
those that count. No input is kept: the number that is printed makes it again, `fuzz.py one KIND N`.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "benchmarks")]

from fuzz_inputs import KINDS, Kind, make_base  # noqa: E402

MAX_TIME, MAX_MEMORY = 5.0, 1e9
"""Processor time [s] and memory [bytes] that an input may take."""
KILL_TIME = 120.0
"""Time after which a child is killed [s]: its processor time is bounded by ``MAX_TIME`` + 1."""
SEED = 1
FINE = ("read", "refused")
"""What may become of an input."""


@dataclass(frozen=True)
class Outcome:
    """What became of an input.

    Attributes:
        what: `read`, `refused` (in one line), `traceback`, `hang`, `memory` or `crash`.
        detail: The last line of a traceback, or the line of a refusal.
        time: Processor time [s].
    """

    what: str
    detail: str
    time: float


def read_in_child(read: Callable[[Path], None], path: Path) -> Outcome:
    """Let a child read ``path`` and return what became of it."""
    # Start the child
    receiver, sender = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receiver)
        _read_and_tell(read, path, sender)
    os.close(sender)

    # Wait for it
    signal.signal(signal.SIGALRM, lambda *_: os.kill(child, signal.SIGKILL))
    signal.setitimer(signal.ITIMER_REAL, KILL_TIME)
    with os.fdopen(receiver, "rb") as pipe:
        told = pipe.read().decode(errors="replace")
    _, status, used = os.wait4(child, 0)
    signal.setitimer(signal.ITIMER_REAL, 0.0)

    # Judge it
    seconds = used.ru_utime + used.ru_stime
    what, _, detail = told.partition("\n")
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return Outcome("hang" if number in (9, 24) else "crash", f"signal {number}", seconds)
    if seconds > MAX_TIME:
        return Outcome("hang", f"{seconds:.1f} s: {what} {detail}", seconds)
    if used.ru_maxrss * 1024 > MAX_MEMORY:
        return Outcome("memory", f"{used.ru_maxrss / 1e6:.2f} GB: {what} {detail}", seconds)
    return Outcome(what or "crash", detail, seconds)


def _read_and_tell(read: Callable[[Path], None], path: Path, sender: int) -> None:
    """Read ``path``, write what became of it to ``sender``, and end the process."""
    from scan3d_twin.core.errors import TwinError

    limit = int(MAX_TIME) + 1
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit += int(used.ru_utime + used.ru_stime)
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            read(path)
        told = "read\n"
    except TwinError as error:
        lines = str(error).splitlines()
        told = (
            f"refused\n{lines[0]}" if len(lines) == 1 else f"traceback\n{len(lines)} lines: {error}"
        )
    except BaseException as error:  # noqa: BLE001 - the point is to catch what should not be
        place = traceback.extract_tb(error.__traceback__)[-1]
        own = [f for f in traceback.extract_tb(error.__traceback__) if "scan3d_twin" in f.filename]
        where = f"{Path(own[-1].filename).name}:{own[-1].lineno}" if own else place.filename
        told = f"traceback\n{type(error).__name__}: {str(error)[:100]} ({where})"
    os.write(sender, told.encode()[:4000])
    os._exit(0)


def run(kind: Kind, base: Path, number: int, folder: Path) -> Outcome:
    """Make input ``number`` of ``kind``, read it and return what became of it."""
    path = kind.make(base, Random(f"{SEED} {kind.name} {number}"), folder)
    return read_in_child(kind.read, path)


class Log:
    """The outcomes so far, in a file of one line an input, so that a long run may be stopped."""

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self.known: dict[tuple[str, int], Outcome] = {}
        lines = path.read_text(encoding="utf-8").splitlines() if path and path.exists() else []
        for line in lines:
            name, number, outcome = json.loads(line)
            self.known[name, number] = Outcome(*outcome)

    def add(self, name: str, number: int, found: Outcome) -> None:
        """Write the outcome of input ``number`` of the kind ``name``."""
        self.known[name, number] = found
        if self.path:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([name, number, astuple(found)]) + "\n")


def count_outcomes(name: str, numbers: Iterable[int], base: Path, log: Log) -> int:
    """Read inputs of the kind ``name`` that are not in ``log``; return how many failed in all."""
    tally, slowest = Counter[str](), 0.0
    for number in numbers:
        # Read it
        if (name, number) not in log.known:
            with tempfile.TemporaryDirectory(dir=base.parent) as folder:
                log.add(name, number, run(KINDS[name], base, number, Path(folder)))

        # Count it
        found = log.known[name, number]
        tally[found.what] += 1
        slowest = max(slowest, found.time)
        if found.what not in FINE:
            print(f"{name} {number}: {found.what} {found.detail}", flush=True)
    parts = ", ".join(f"{what} {tally[what]}" for what in sorted(tally))
    print(f"{name}: {tally.total()} inputs: {parts}; slowest {slowest:.1f} s", flush=True)
    return sum(tally[what] for what in tally if what not in FINE)


def main() -> None:
    """Make and read the inputs, and print what became of them."""
    # Read the arguments
    arguments, log = sys.argv[1:], Log(None)
    if "--log" in arguments:
        place = arguments.index("--log")
        log = Log(Path(arguments[place + 1]))
        del arguments[place : place + 2]
    if arguments[0] == "one":
        names, numbers = arguments[1:2], range(int(arguments[2]), int(arguments[2]) + 1)
    else:
        names = arguments[1:] or [name for name in KINDS if name != "recover"]
        numbers = range(-(-int(arguments[0]) // len(names)))

    # Read the inputs, kind by kind
    with tempfile.TemporaryDirectory() as root:
        base, began = make_base(Path(root) / "base"), time.monotonic()
        bad = sum(count_outcomes(name, numbers, base, log) for name in names)
    if arguments[0] == "one":
        print(log.known[names[0], numbers[0]])
    took = time.monotonic() - began
    print(f"{bad} of {len(numbers) * len(names)} inputs failed; {took:.0f} s")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
