#!/bin/bash
# Compile a package of messages, services or actions that the wheels of ROS do not have, and put it beside
# them into .venv, which set-up has made. What the user compiled in another clone is taken from there.
#
#   tools/add_messages.sh FOLDER     of the package; in its path only ASCII letters. Folders FOLDER.* are made
set -euo pipefail
root="$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)"
venv="$root/.venv"
folder=$1

set +u; . "$venv/bin/activate"; . "$venv/local_setup.sh"; set -u
cache() { python "$root/src/plate_native/plate_native/cache.py" "$1" "$folder" "$folder.made$venv" "$root"; }
if ! cache take; then
    cmake -G Ninja -S "$folder" -B "$folder.build" -DCMAKE_INSTALL_PREFIX="$venv" -DCMAKE_PREFIX_PATH="$venv" \
        -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF -DWITHOUT_CPP=ON
    DESTDIR="$folder.made" cmake --build "$folder.build" --target install
    cache keep || true
fi
cp -a "$folder.made$venv/." "$venv"
