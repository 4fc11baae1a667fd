"""Mutation testing: break the code in small ways and see whether the tests notice.

    python tools/mutate.py [scan3d_twin/devices/urg/codec.py ...] [--sample 20]

Works in a copy of the checkout, on the codecs and the drivers if no modules are named. Prints one
line for each mutant the tests did not notice; docstrings and type hints are left alone. The same
arguments give the same mutants.
"""

from __future__ import annotations

import argparse
import ast
import copy
import math
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import hypothesis.strategies  # noqa: F401 - slow to import; the forks need it
import numpy as np  # noqa: F401
import pytest
import serial  # noqa: F401

ROOT = Path(__file__).resolve().parent.parent
DEVICES, REAL = Path("scan3d_twin/devices"), Path("scan3d_twin/real")
GOLDEN = "tests/golden"
URG = [
    "tests/devices/urg/test_scan_modes.py",
    "tests/devices/urg/test_lines.py",
    "tests/devices/urg/test_driver.py",
]
CREATE = ["tests/devices/create/test_driver.py", "-k", "not million"]
RPLIDAR = ("codec", "capsules", "nodes", "frames", "link", "connect", "samples", "driver", "probe")
TESTS = {
    DEVICES / "create/codec.py": [GOLDEN, "tests/devices/create/test_codec.py"],
    DEVICES / "create/packets.py": [GOLDEN, "tests/devices"],
    DEVICES / "urg/codec.py": ["tests/devices"],
    DEVICES / "urg/replies.py": ["tests/devices", GOLDEN],
    DEVICES / "urg/model.py": [GOLDEN, "tests/devices"],
    REAL / "clock.py": ["tests/real/test_clock.py"],
    DEVICES / "create/driver.py": CREATE,
    DEVICES / "create/inquiry.py": CREATE,
    DEVICES / "create/receiver.py": CREATE,
    DEVICES / "create/heartbeat.py": CREATE,
    DEVICES / "create/hazards.py": ["tests/devices/create/test_hazards.py"],
    DEVICES / "create/identification.py": ["tests/devices/create/test_identification.py"],
    DEVICES / "create/link.py": ["tests/devices/create/test_link.py", *CREATE],
    DEVICES / "create/dead_reckoning.py": ["tests/devices/create/test_dead_reckoning.py"],
    DEVICES / "create/reading_filter.py": ["tests/devices/create/test_reading_filter.py"],
    DEVICES / "links/guard.py": ["tests/devices/links/test_guard.py"],
    DEVICES / "links/guard_process.py": ["tests/devices/links/test_guard.py"],
    REAL / "suspension.py": ["tests/devices/links/test_guard.py"],
    REAL / "ports.py": ["tests/real/test_ports.py"],
    REAL / "robot.py": ["tests/contract", "tests/devices/links/test_unplugged.py"],
    DEVICES / "links/transport.py": [
        "tests/devices/links/test_transport.py",
        "tests/devices/links/test_unplugged.py",
    ],
    DEVICES / "reconnecting.py": ["tests/devices/ldrobot/test_ld_driver.py", *URG],
    DEVICES / "urg/driver.py": URG,
    DEVICES / "urg/clock_sync.py": ["tests/devices/urg/test_clock_sync.py", *URG],
    DEVICES / "urg/connect.py": URG,
    DEVICES / "urg/lines.py": ["tests/devices/urg/test_lines.py", *URG],
    DEVICES / "urg/link.py": URG,
    DEVICES / "urg/scan_modes.py": ["tests/devices/urg/test_scan_modes.py", *URG],
    DEVICES / "rplidar/reading_filter.py": ["tests/devices/rplidar/test_driver.py"],
    **{DEVICES / f"rplidar/{name}.py": ["tests/devices/rplidar"] for name in RPLIDAR},
}
"""Tests that should fail for a mutant, by module; the quick ones first."""
PATIENCE = 5.0
"""Factor on the time of the tests without a mutant after which they count as hanging: noticed."""
COMPARISONS = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq},
    **{ast.NotEq: ast.Eq, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Is: ast.IsNot},
    ast.IsNot: ast.Is,
}
OPERATORS = {
    **{ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.Div: ast.Mult},
    **{ast.FloorDiv: ast.Div, ast.Mod: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift},
    **{ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd, ast.BitXor: ast.BitAnd},
}


def mutants(tree: ast.Module) -> Iterator[tuple[int, str, ast.Module]]:
    """Yield (line, what was changed, changed module)."""
    unread = set(_unread(tree))
    for index, node in enumerate(ast.walk(tree)):
        for name, change in () if node in unread else changes(node):
            other = copy.deepcopy(tree)
            target = next(n for i, n in enumerate(ast.walk(other)) if i == index)
            before = ast.unparse(target)
            change(target)
            yield getattr(node, "lineno", 0), f"{before}  ->  {ast.unparse(target)} ({name})", other


def _unread(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield what no program's result depends on: type hints, and how a dataclass is made."""
    for node in ast.walk(tree):
        hints = [getattr(node, name, None) for name in ("annotation", "returns")]
        for part in [*hints, *getattr(node, "decorator_list", [])]:
            yield from ast.walk(part) if part is not None else ()


def changes(node: ast.AST) -> Iterator[tuple[str, object]]:
    """Yield the ways to break ``node``."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS:
        new = COMPARISONS[type(node.ops[0])]
        yield "comparison", lambda n: n.ops.__setitem__(0, new())
    elif isinstance(node, (ast.BinOp, ast.AugAssign)) and type(node.op) in OPERATORS:
        swap = OPERATORS[type(node.op)]
        yield "operator", lambda n: setattr(n, "op", swap())
    elif isinstance(node, ast.BoolOp):
        yield (
            "and/or",
            lambda n: setattr(n, "op", ast.Or() if isinstance(n.op, ast.And) else ast.And()),
        )
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield (
            "not",
            lambda n: (
                setattr(n, "op", ast.UAdd())
                or setattr(n, "operand", ast.Call(ast.Name("bool", ast.Load()), [n.operand], []))
            ),
        )
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield "constant", lambda n: setattr(n, "value", not n.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        yield "constant", lambda n: setattr(n, "value", n.value * 2 or 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, bytes) and node.value:
        yield "bytes", lambda n: setattr(n, "value", n.value + b"!")


def run(copy_root: Path, tests: list[str], timeout: float) -> bool:
    """Return whether ``tests`` pass in the copy within ``timeout`` [s].

    In a fork of this process, which has imported what is slow to import.
    """
    child = os.fork()
    if child == 0:
        os._exit(_test(copy_root, tests))
    try:
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status) == 0
            time.sleep(0.02)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return False
    finally:
        end_what_is_left(copy_root)


def end_what_is_left(copy_root: Path) -> None:
    """End the processes that run code of the copy: a mutant of the guard may never end."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if os.fsencode(copy_root) in (process / "cmdline").read_bytes():
                os.kill(int(process.name), signal.SIGKILL)


def _test(copy_root: Path, tests: list[str]) -> int:
    """Run ``tests``, in silence."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)
    os.chdir(copy_root)
    sys.path.insert(0, str(copy_root))
    sys.dont_write_bytecode = True
    os.environ["PYTHONPATH"] = str(copy_root)
    options = ["-q", "-x", "-p", "no:cacheprovider", "--timeout", "0"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    return int(pytest.main([*options, *tests]))


def copy_to(place: Path) -> None:
    """Copy what the tests need."""
    for name in ("scan3d_twin", "tests", "assets", "scenes", "pyproject.toml"):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, place / name)


def check(module: Path, place: Path, sample: int) -> tuple[int, int]:
    """Print the mutants of ``module`` that survive; return how many, and of how many."""
    found = list(mutants(ast.parse((ROOT / module).read_text())))
    if sample:
        found = found[:: math.ceil(len(found) / sample)]
    started = time.monotonic()
    if not run(place, TESTS[module], math.inf):
        sys.exit(f"{module}: its tests do not pass as it is")
    timeout = PATIENCE * (time.monotonic() - started)
    survivors = 0
    for line, words, tree in found:
        (place / module).write_text(ast.unparse(tree))
        if run(place, TESTS[module], timeout):
            survivors += 1
            print(f"{module}:{line}: {words}", flush=True)
    shutil.copy(ROOT / module, place / module)
    print(f"{module}: {survivors} of {len(found)} mutants survived", flush=True)
    return survivors, len(found)


def main() -> int:
    """Run the mutants and return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", type=Path, default=list(TESTS))
    parser.add_argument(
        "--sample",
        type=int,
        default=0,
        help="at most this many of a module, evenly spread; 0 is all",
    )
    options = parser.parse_args()
    unknown = [str(module) for module in options.modules if module not in TESTS]
    if unknown:
        parser.error(f"no tests are known for {', '.join(unknown)}; see TESTS")
    with tempfile.TemporaryDirectory() as folder:
        copy_to(Path(folder))
        counts = [check(module, Path(folder), options.sample) for module in options.modules]
    survivors, total = (sum(column) for column in zip(*counts, strict=True))
    print(f"{survivors} of {total} mutants survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
