#!/bin/sh
# Set up .venv with everything the lock file names. Every failure is one line: cause and cure.
# The package index is the user's own choice: UV_* and PIP_* variables and pip.conf are respected.
set -u
cd "$(dirname "$0")/.." || exit 1

UV_VERSION=0.13.9
export UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT=.venv PIP_DISABLE_PIP_VERSION_CHECK=1
# Otherwise the first run compiles every module it imports.
export UV_COMPILE_BYTECODE=1
export PIP_RETRIES="${PIP_RETRIES:-1}" UV_HTTP_RETRIES="${UV_HTTP_RETRIES:-1}"
unset VIRTUAL_ENV PYTHONHOME PYTHONPATH
python=${PYTHON:-python3}

fail() {
    echo "error: $*" >&2
    exit 1
}

# Says what comes next and how long that usually takes, for it may take a while in silence.
step() {
    echo "set-up: $1 ($2)"
}

# Why a download failed, from the log of the program that tried.
download_failed() {
    if grep -qiE 'no space left' "$log"; then
        fail "cannot set up .venv: the disk is full; free about 1 GB and run make again"
    elif grep -qiE 'connect|resolution|resolve host|dns error|timed out|unreachable|retr(y|ies)|(proxy|ssl)error' "$log"; then
        fail "cannot download $1: the package index does not answer; check the network, or name a mirror in PIP_INDEX_URL (details: $log)"
    fi
    fail "cannot install $1: $(grep -iE 'error' "$log" | head -n 1) (details: $log)"
}

create_venv() {
    command -v "$python" >/dev/null 2>&1 ||
        fail "$python not found; install Python 3.11, 3.12 or 3.13 (Debian: apt install python3 python3-venv)"
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) ||
        fail "$python does not run; name a working Python 3.11, 3.12 or 3.13: make PYTHON=/path/to/python3"
    case $version in
        3.11 | 3.12 | 3.13) ;;
        *) fail "$python is Python $version but 3.11, 3.12 or 3.13 is needed; name one: make PYTHON=python3.11" ;;
    esac
    "$python" -c 'import ensurepip, venv' 2>/dev/null ||
        fail "$python has no venv module; install it (Debian, Ubuntu: apt install python3-venv)"
    step "making .venv" "about 4 s"
    "$python" -m venv .venv >"$log" 2>&1 || {
        rm -rf .venv
        fail "cannot create .venv in $PWD: $(tail -n 1 "$log" 2>/dev/null)"
    }
}

install_uv() {
    [ "$(.venv/bin/uv --version 2>/dev/null | cut -d' ' -f2)" = "$UV_VERSION" ] && return
    step "installing uv $UV_VERSION, which installs the rest" "about 2 s"
    .venv/bin/python -m pip install --quiet "uv==$UV_VERSION" >"$log" 2>&1 || download_failed "uv $UV_VERSION"
}

# On a terminal uv shows its progress itself, and what it says is gone; a failure is then tried again
# in silence, for its reason.
run_uv_sync() {
    [ -t 2 ] && .venv/bin/uv sync --locked "$@" && return
    .venv/bin/uv sync --locked --quiet "$@" >"$log" 2>&1
}

own_uv_index() {
    env | grep -qE '^UV_(DEFAULT_INDEX|INDEX|INDEX_URL|EXTRA_INDEX_URL|FIND_LINKS|NO_INDEX|CONFIG_FILE)='
}

# The same locked versions and hashes, through an index the lock file does not name.
install_from_own_index() {
    requirements=.venv/requirements.txt
    .venv/bin/uv export --frozen --quiet --no-emit-project -o $requirements >"$log" 2>&1 || return
    if own_uv_index; then
        pip="env VIRTUAL_ENV=.venv .venv/bin/uv pip"
    else
        pip=".venv/bin/python -m pip"
    fi
    $pip install --quiet --require-hashes -r $requirements >"$log" 2>&1 &&
        $pip install --quiet --no-deps -e . >"$log" 2>&1
}

install_locked() {
    step "installing the packages of uv.lock" "about 20 s, longer for what has to be downloaded"
    run_uv_sync --no-install-project || return
    step "compiling the engine of the registration" "about 7 s"
    run_uv_sync
}

install_project() {
    install_locked && return
    if grep -qE 'needs to be updated|unsatisfiable' "$log" && ! own_uv_index; then
        fail "uv.lock does not fit pyproject.toml; run .venv/bin/uv lock and then make again"
    fi
    install_from_own_index || download_failed "the packages of uv.lock"
}

log=$(mktemp "${TMPDIR:-/tmp}/scan3d_twin-setup.XXXXXX") || fail "cannot write to ${TMPDIR:-/tmp}"
.venv/bin/python -c 'import sys' >/dev/null 2>&1 || create_venv
install_uv
install_project
rm -f "$log"
