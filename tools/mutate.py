"""Mutation testing: break the code in small ways and see whether the tests notice.

    python tools/mutate.py scan3d_twin/protocols/scip.py --tests tests/protocols [--sample 50]

Works in a copy of the checkout. Prints one line for each mutant the tests did not notice;
docstrings and type hints are left alone. The same arguments give the same mutants.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
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
    for index, node in enumerate(ast.walk(tree)):
        for name, change in changes(node):
            other = copy.deepcopy(tree)
            target = next(n for i, n in enumerate(ast.walk(other)) if i == index)
            before = ast.unparse(target)
            change(target)
            yield getattr(node, "lineno", 0), f"{before}  ->  {ast.unparse(target)} ({name})", other


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


def run(copy_root: Path, tests: list[str]) -> bool:
    """Return whether ``tests`` pass in the copy."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy_root), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        ended = subprocess.run(
            [*command, "--timeout", "30"],
            cwd=copy_root,
            env=environment,
            capture_output=True,
            timeout=180,
        )
    except subprocess.TimeoutExpired:
        return False
    return ended.returncode == 0


def main() -> int:
    """Run the mutants and return 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="+", type=Path)
    parser.add_argument("--tests", nargs="+", required=True)
    parser.add_argument(
        "--sample", type=int, default=0, help="about this many, evenly spread; 0 is all"
    )
    options = parser.parse_args()
    found = [
        (module, *mutant)
        for module in options.modules
        for mutant in mutants(ast.parse((ROOT / module).read_text()))
    ]
    if options.sample:
        found = found[:: max(1, len(found) // options.sample)]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for name in ("scan3d_twin", "tests", "assets", "scenes", "pyproject.toml"):
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, place / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, place / name)
        if not run(place, options.tests):
            print("the tests do not pass as they are", file=sys.stderr)
            return 2
        survivors = 0
        for module, line, words, tree in found:
            (place / module).write_text(ast.unparse(tree))
            if run(place, options.tests):
                survivors += 1
                print(f"{module}:{line}: {words}", flush=True)
            shutil.copy(ROOT / module, place / module)
    print(f"{survivors} of {len(found)} mutants survived")
    return 0


if __name__ == "__main__":
    sys.exit(main())
