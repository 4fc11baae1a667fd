#!/bin/sh
# Without -target, `zig cc` of ziglang 0.17.1 compiles for the processor it runs on; with one, even
# that of the machine, for the baseline of the architecture. gcc and clang always do the latter, so a
# binary built by zig's default may not run elsewhere. Exits 0 while that is so, 1 if not, 2 if the
# processor is too old to show the difference.
set -eu
if ! grep -qw avx2 /proc/cpuinfo; then
    echo "this processor has no AVX2: both are the same here" >&2
    exit 2
fi
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet 'ziglang==0.17.1'
echo 'int main(void) { return 0; }' > main.c

avx2() { # the compiler's command; says whether what it compiles may use AVX2
    "$@" -dM -E main.c > macros
    if grep -q '__AVX2__' macros; then said=yes; else said=no; fi
    echo "$*: AVX2 $said"
}

echo "zig $(venv/bin/python -m ziglang version)"
avx2 venv/bin/python -m ziglang cc
[ "$said" = yes ] || exit 1
avx2 venv/bin/python -m ziglang cc -target x86_64-linux-gnu
[ "$said" = no ] || exit 1
avx2 venv/bin/python -m ziglang cc -mcpu=baseline
[ "$said" = no ] || exit 1
if command -v gcc > /dev/null; then avx2 gcc; fi
echo "as described: the default is the host's CPU"
