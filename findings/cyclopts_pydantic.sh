#!/bin/sh
# cyclopts 5.4.0 validates arguments with pydantic as soon as any module has imported pydantic: a
# parameter `options: Annotated[Options, Parameter(name="*")] = None` then fails for None, with the same
# command line that works without. Exits 0 while that is so, 1 if not.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv here
here/bin/pip install --quiet cyclopts==5.4.0 pydantic==2.14.4
cat > look.py <<'EOF'
import sys
from dataclasses import dataclass
from typing import Annotated

if sys.argv.pop(1) == "with":
    import pydantic  # noqa: F401
from cyclopts import App, Parameter


@dataclass
class Options:
    size: int | None = None


def command(*, options: Annotated[Options, Parameter(name="*")] = None) -> None:
    print(f"options: {options}")


App(default_command=command)(sys.argv[1:])
EOF
echo "without pydantic:" && here/bin/python look.py without
echo "with pydantic:" && if here/bin/python look.py with; then exit 1; fi
