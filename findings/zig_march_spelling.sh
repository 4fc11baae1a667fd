#!/bin/sh
# `zig cc` of ziglang 0.17.1 refuses the names of the x86-64 levels that gcc and clang accept for
# -march, and accepts them with underscores only. Exits 0 while that is so, else 1.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet 'ziglang==0.17.1'
echo 'int main(void) { return 0; }' > main.c

compile() { # the level as the compiler is to spell it; says what came of it
    if venv/bin/python -m ziglang cc -target x86_64-linux-gnu "-march=$1" -c main.c -o main.o > log 2>&1
    then said=compiled
    else said=$(grep '^error:' log)
    fi
    echo "zig cc -march=$1: $said"
}

echo "zig $(venv/bin/python -m ziglang version)"
for level in 2 3 4; do
    compile "x86-64-v$level"
    [ "$said" = "error: unknown CPU: 'x86'" ] || exit 1
    compile "x86_64_v$level"
    [ "$said" = compiled ] || exit 1
done
if command -v gcc > /dev/null && [ "$(uname -m)" = x86_64 ]; then
    gcc -march=x86-64-v3 -c main.c -o main.o
    echo "gcc -march=x86-64-v3: compiled"
fi
echo "as described: it takes x86 alone for the name of the CPU"
