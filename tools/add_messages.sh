#!/bin/bash
# Compile a package of messages, services or actions that the wheels of ROS do not have, and put it beside
# them into .venv, which set-up has made.
#
#   tools/add_messages.sh FOLDER     of the package; in its path only ASCII letters. FOLDER/build is made
set -euo pipefail
venv="$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)/.venv"
folder=$1

set +u; . "$venv/bin/activate"; . "$venv/local_setup.sh"; set -u
cmake -G Ninja -S "$folder" -B "$folder/build" -DCMAKE_INSTALL_PREFIX="$venv" -DCMAKE_PREFIX_PATH="$venv" \
    -DPython3_EXECUTABLE="$venv/bin/python" -DBUILD_TESTING=OFF -DWITHOUT_CPP=ON
cmake --build "$folder/build" --target install
