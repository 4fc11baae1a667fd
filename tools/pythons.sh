#!/bin/sh
# Build the wheel and run it outside the checkout on each Python that can be found: with the newest
# packages on all of them, and with the oldest that pyproject.toml allows on the first.
set -eu
cd "$(dirname "$0")/.."
export UV_PYTHON_DOWNLOADS=never
uv=$PWD/.venv/bin/uv
for bin in "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin; do
    PATH=$bin:$PATH  # its shims answer for one version alone
done

work=$(mktemp -d "${TMPDIR:-/tmp}/scan3d_twin-pythons.XXXXXX")
trap 'rm -rf "$work"' EXIT
"$uv" build --quiet --wheel --out-dir "$work"

# Record a short run in the twin, and do with it what dispatches on types at run time.
smoke() {
    python=$1 resolution=$2 place=$work/$1-$2
    "$uv" venv --quiet --python "$python" "$place"
    "$uv" pip compile --quiet --python "$place/bin/python" --resolution "$resolution" pyproject.toml -o "$place/packages.txt"
    "$uv" pip install --quiet --python "$place/bin/python" -r "$place/packages.txt"
    "$uv" pip install --quiet --python "$place/bin/python" --no-deps "$work"/*.whl
    (
        cd "$place"
        bin/twin sim --scene three_boxes --max-views 2 --sweep.yaw-rate 0.5 --out run >log 2>&1 &&
            bin/twin session info run >>log 2>&1 &&
            bin/twin replay run >>log 2>&1 &&
            bin/twin export run --to ply --out cloud.ply >>log 2>&1 &&
            bin/twin mesh run --out mesh.ply >>log 2>&1 &&
            bin/twin session drop-view run 1 >>log 2>&1
    ) || {
        tail -n 5 "$place/log" >&2
        echo "error: the wheel does not run on Python $python with the $resolution packages" >&2
        return 1
    }
    echo "Python $python, $resolution packages: $("$place/bin/python" -c 'import numpy; print("NumPy", numpy.__version__)'): runs"
}

# All at once: a good part of it waits for files.
found=0 oldest='' started='' failed=0
for version in 3.11 3.12 3.13 3.14; do
    "$uv" python find --quiet "$version" >/dev/null 2>&1 || continue
    found=$((found + 1))
    oldest=${oldest:-$version}
    smoke "$version" highest &
    started="$started $!"
done
smoke "$oldest" lowest-direct &
for each in $started $!; do
    wait "$each" || failed=1
done
[ "$failed" = 0 ] || exit 1
echo "$found Pythons tried"
