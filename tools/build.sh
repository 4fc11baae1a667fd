#!/bin/sh
# Build wheel and sdist, install the wheel into an empty environment and run it far from the checkout.
set -eu
cd "$(dirname "$0")/.."
uv=$PWD/.venv/bin/uv
export UV_PYTHON_DOWNLOADS=never

rm -rf dist
"$uv" build --quiet --out-dir dist
empty=$(mktemp -d)
trap 'rm -rf "$empty"' EXIT
"$uv" export --frozen --quiet --no-dev --no-emit-project -o "$empty/constraints.txt"
"$uv" venv --quiet --python .venv/bin/python "$empty/venv"
VIRTUAL_ENV="$empty/venv" "$uv" pip install --quiet --constraints "$empty/constraints.txt" dist/*.whl

twin=$empty/venv/bin/twin
cd "$empty"
"$twin" --version
"$twin" scenes
"$twin" sim --scene three_boxes --max-views 2 --epsilon 50 --out "$empty/run"
test -s "$empty/run/model.ply" && test -s "$empty/run/report.json" && test -s "$empty/run/top_view.svg"
echo "the wheel works on its own"
