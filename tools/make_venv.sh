#!/bin/sh
# make_venv.sh FOLDER [PYTHON]: a virtual environment with pip, also where the system's Python came without ensurepip.
set -eu
folder=$1
python=${2:-}

supported() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null; }

if [ -z "$python" ]; then
    for name in python3 python3.13 python3.12 python3.11; do
        if supported "$name"; then python=$name; break; fi
    done
    if [ -z "$python" ]; then
        echo "Python 3.11, 3.12 or 3.13 is needed and none was found: install one, or name it with PYTHON=/path/to/python3" >&2
        exit 1
    fi
elif ! supported "$python"; then
    echo "PYTHON=$python is not a Python 3.11, 3.12 or 3.13: name one that is, for example PYTHON=python3.12" >&2
    exit 1
fi

echo "Making $folder with $("$python" --version)"
rm -rf "$folder"
if "$python" -m venv "$folder" >/dev/null 2>&1; then exit 0; fi

# Debian and Ubuntu keep ensurepip in the package python3-venv; the system's own pip can do its work.
rm -rf "$folder"
if "$python" -m venv --without-pip "$folder" &&
    "$python" -m pip --quiet --disable-pip-version-check --python "$folder/bin/python" install pip; then
    exit 0
fi
rm -rf "$folder"
echo "No virtual environment could be made with $python: install pip or venv for it (on Debian: apt install python3-venv)" >&2
exit 1
