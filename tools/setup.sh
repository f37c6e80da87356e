#!/usr/bin/env bash
# Makes .venv with everything the project needs, from Python wheels and one compilation: no ROS installation.
# Does only what is missing; the second call takes a second. PYTHON=... chooses the interpreter of a new environment.
set -euo pipefail
cd "$(dirname "$0")/.."

readonly VENV=.venv
readonly EXTRAS=ros,build,test
readonly STAMP=$VENV/setup.sha256

# Prints why an interpreter cannot carry the environment; nothing if it can.
problem_with() {
    command -v "$1" > /dev/null || { echo "not found"; return; }
    "$1" - 2> /dev/null <<'PY' || echo "does not run"
import importlib.util, pathlib, sys, sysconfig
version = "%d.%d" % sys.version_info[:2]
if not (3, 11) <= sys.version_info[:2] <= (3, 12):
    print("is Python %s; 3.11 or 3.12 is needed" % version)
elif not importlib.util.find_spec("ensurepip"):
    print("has no venv (Debian, Ubuntu: sudo apt install python%s-venv)" % version)
elif not (pathlib.Path(sysconfig.get_path("include")) / "Python.h").is_file():
    print("has no headers (Debian, Ubuntu: sudo apt install python%s-dev)" % version)
PY
}

choose_python() {
    local candidate problem reasons=""
    for candidate in ${PYTHON:-python3 python3.12 python3.11 /usr/bin/python3}; do
        problem=$(problem_with "$candidate")
        if [[ -z $problem ]]; then
            echo "$candidate"
            return
        fi
        reasons+="  $candidate $problem"$'\n'
    done
    printf 'setup: no suitable Python:\n%s' "$reasons" >&2
    return 1
}

require_compiler() {
    if [[ -z ${CXX:-} ]] && ! command -v c++ > /dev/null; then
        echo "setup: no C++ compiler (Debian, Ubuntu: sudo apt install g++)" >&2
        return 1
    fi
}

require_compiler
mkdir -p $VENV
exec 9> $VENV/setup.lock
flock --nonblock 9 || { echo "setup: waiting for another setup of $VENV ..."; flock 9; }

if ! $VENV/bin/python -m pip --version > /dev/null 2>&1; then
    python=$(choose_python)
    echo "setup: creating $VENV with $("$python" --version)"
    "$python" -m venv $VENV
fi

wanted=$(cat setup.py setup.cfg pyproject.toml | sha256sum)
if [[ ! -f $STAMP || $(< $STAMP) != "$wanted" ]]; then
    echo "setup: installing dependencies (several hundred MB the first time)"
    $VENV/bin/python -m pip install --disable-pip-version-check --editable ".[$EXTRAS]"
    echo "$wanted" > $STAMP
fi

$VENV/bin/python tools/build_interfaces.py
