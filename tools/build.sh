#!/bin/sh
# Build the sdist and a wheel for each architecture, by zig for glibc 2.28 or later, all Pythons; install
# the wheel of this one into an empty environment, without a compiler, and run it far from the checkout.
set -eu
cd "$(dirname "$0")/.."
uv=$PWD/.venv/bin/uv
export UV_PYTHON_DOWNLOADS=never

rm -rf dist
"$uv" build --quiet --sdist --out-dir dist
for architecture in x86_64 aarch64; do
    SCAN3D_TWIN_TARGET=$architecture-linux-gnu.2.28 "$uv" build --quiet --wheel --out-dir dist
done
empty=$(mktemp -d)
trap 'rm -rf "$empty"' EXIT
"$uv" export --frozen --quiet --no-dev --no-emit-project -o "$empty/constraints.txt"
"$uv" venv --quiet --python .venv/bin/python "$empty/venv"
VIRTUAL_ENV="$empty/venv" "$uv" pip install --quiet --constraints "$empty/constraints.txt" dist/*_"$(uname -m)".whl

twin=$empty/venv/bin/twin
cd "$empty"
"$twin" --version
"$twin" scenes
"$twin" sim --scene three_boxes --max-views 2 --epsilon 50 --out "$empty/run"
test -s "$empty/run/model.ply" && test -s "$empty/run/report.json" && test -s "$empty/run/top_view.svg"
echo "the wheel works on its own"
