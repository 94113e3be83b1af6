#!/bin/bash
# Install the commands `ros2 ...` and ROS's launch into .venv, where ROS comes as wheels: they have none,
# so their sources are fetched. Only tests of the launch files need them, too.
#
#   tools/cli.sh     SOURCES=https://github.com: the place of the repositories, owner/name below it
set -euo pipefail
cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."
SOURCES=${SOURCES:-https://github.com}
log="$PWD/log/cli.log"
# The generators of messages read no path with spaces or other letters than ASCII.
case "${TMPDIR:-}" in *[!A-Za-z0-9/._-]*) scratch=$(mktemp -d -p /tmp) ;; *) scratch=$(mktemp -d 2> /dev/null || mktemp -d -p /tmp) ;; esac
trap 'rm -rf "$scratch"' EXIT

# Branch jazzy of each repository, and the folders of it that are installed
repositories="
    ros2/ros2cli            de6cd27284937044d8dff47a617581c28865210c  ros2cli ros2action ros2interface ros2lifecycle ros2node ros2param ros2pkg ros2run ros2service ros2topic
    ros2/launch             09403fcebedb68dd259e9ab6b35bd8712b6596ec  launch launch_xml launch_yaml
    ros2/launch_ros         62c56e53e86812023697fe330c83d327f54e7b18  launch_ros ros2launch
    ros2/rosidl_runtime_py  df2361f64ecb85f65f4bf22e804424e0f1ac4197  .
    ros2/rcl_interfaces     003987ecb81a32802ab27dd6d325b8c6b8b813cc
"
wheels=(osrf-pycommon==2.0.2 psutil==7.2.2)

say() { echo "cli: $*"; }
fail() { say "$*" >&2; exit 1; }

fetch() { # repository commit
    git init -q "$scratch/$1" &&
        GIT_TERMINAL_PROMPT=0 timeout 300 git -C "$scratch/$1" fetch -q --depth 1 "$SOURCES/$1" "$2" &&
        git -C "$scratch/$1" checkout -q FETCH_HEAD
}

case "$(cat .venv/.foundation)" in jazzy*) say "your ROS has them: sudo apt install ros-jazzy-ros-base"; exit ;; esac
exec 9< tools/setup.sh
flock -n 9 || { say "waiting for a set-up of this folder to end"; flock 9; }
: > "$log"
pip=(.venv/bin/python -m pip --disable-pip-version-check --no-input -qq install)
say "fetching from $SOURCES"
folders=()
while read -r repository commit packages; do
    [ -n "$repository" ] || continue
    fetch "$repository" "$commit" >> "$log" 2>&1 ||
        fail "$SOURCES/$repository cannot be fetched: $(grep -m 1 fatal "$log" || tail -n 1 "$log")"
    for package in $packages; do folders+=("$scratch/$repository/$package"); done
done <<< "$repositories"

say "installing"
"${pip[@]}" --only-binary :all: -c constraints.txt "${wheels[@]}" >> "$log" 2>&1 || fail "pip could not install ${wheels[*]}: $(tail -n 1 "$log")"
"${pip[@]}" --no-deps --no-build-isolation "${folders[@]}" >> "$log" 2>&1 || fail "pip could not install the sources, see $log"
tools/add_messages.sh "$scratch/ros2/rcl_interfaces/composition_interfaces" >> "$log" 2>&1 ||
    fail "composition_interfaces could not be built, see $log"
say "ready: source env.sh && ros2 --help"
