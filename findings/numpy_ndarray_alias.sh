#!/bin/sh
# On Python 3.12 and later, numpy 2.5.5's NDArray is a type alias (PEP 695): the origin of
# NDArray[np.float64] is the alias and no longer numpy.ndarray, so that code which looks at
# annotations while it runs, as `isinstance(x, typing.get_origin(annotation))`, raises TypeError.
# numpy 2.4.6 gave numpy.ndarray. Exits 0 while that is so, 1 if not, 2 without such a Python.
set -eu
for python in "${PYTHON:-python3}" python3.14 python3.13 python3.12; do
    if "$python" -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2> /dev/null; then
        newer=$python
        break
    fi
done
if [ -z "${newer:-}" ]; then
    echo "Python 3.12 or later is needed: set PYTHON" >&2
    exit 2
fi
newer=$(command -v "$newer")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
cat > look.py <<'EOF'
import sys
import typing

import numpy as np
from numpy.typing import NDArray


def mean(values: NDArray[np.float64]) -> float:
    return float(values.mean())


origin = typing.get_origin(typing.get_type_hints(mean)["values"])
try:
    outcome = str(isinstance(np.zeros(3), origin))
except TypeError as error:
    outcome = f"TypeError: {error}"
print(f"Python {sys.version.split()[0]}, numpy {np.__version__}: NDArray is a {type(NDArray).__name__}")
print(f"  origin of NDArray[np.float64]: {origin}; isinstance(np.zeros(3), it): {outcome}")
sys.exit(0 if (origin is np.ndarray) == (sys.argv[1] == "class") else 1)
EOF
for release in 2.4.6=class 2.5.5=alias; do
    "$newer" -m venv "${release#*=}"
    "${release#*=}/bin/pip" install --quiet "numpy==${release%=*}"
    "${release#*=}/bin/python" look.py "${release#*=}"
done
echo "as described: NDArray is no longer a class that isinstance accepts"
