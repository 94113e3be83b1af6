# Enter the workspace: `source env.sh` (bash or zsh) activates its Python and makes its packages known.
# Every setting below can be set beforehand to something else.

_plate_root="$(cd -- "$(dirname -- "${BASH_SOURCE[0]:-${(%):-%x}}")" && pwd)"
_plate_shell=bash
[ -n "${ZSH_VERSION:-}" ] && _plate_shell=zsh

if [ -f "$_plate_root/.venv/bin/activate" ] && [ -f "$_plate_root/install/setup.$_plate_shell" ]; then
    _plate_others="${PYTHONPATH:-}"
    . "$_plate_root/.venv/bin/activate"
    . "$_plate_root/install/setup.$_plate_shell"

    # ROS: stay on this machine (docs/machines.md: how to open the graph to others), find nodes quickly
    export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
    export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_plate_root/config/fastdds.xml}"
    export SKIP_DEFAULT_XML_FILE="${SKIP_DEFAULT_XML_FILE:-1}"  # none that lies in the current folder

    # Logs and caches stay in the clone: the home folder need not be there, nor be writable
    export ROS_LOG_DIR="${ROS_LOG_DIR:-$_plate_root/log/ros}"
    export MPLCONFIGDIR="${MPLCONFIGDIR:-$_plate_root/.matplotlib_cache}"

    # Where there is no `ros2`: `plate goal sort_4`, `plate --help`, `feasible --scenario sort_4`
    case ":$PATH:" in
        *":$_plate_root/install/plate_core/lib/plate_core:"*) ;;
        *) export PATH="$_plate_root/install/plate_client/lib/plate_client:$_plate_root/install/plate_core/lib/plate_core:$_plate_root/install/plate_bringup/lib/plate_bringup:$PATH" ;;
    esac

    # Programs of tools/ and bench/ import modules from their own folder
    unset PYTHONSAFEPATH

    # ROS from wheels contains one middleware
    if [ -f "$_plate_root/.venv/lib/librmw_fastrtps_cpp.so" ] && [ -n "${RMW_IMPLEMENTATION:-}" ] &&
        [ ! -f "$_plate_root/.venv/lib/lib$RMW_IMPLEMENTATION.so" ]; then
        echo "env.sh: RMW_IMPLEMENTATION is '$RMW_IMPLEMENTATION', but the ROS in .venv contains only rmw_fastrtps_cpp." >&2
        echo "env.sh: run this command, and repeat: unset RMW_IMPLEMENTATION" >&2
        unset _plate_root _plate_shell _plate_others
        return 1 2>/dev/null || exit 1
    fi

    # Libraries of this project's Python give warnings, which must not end a program
    case "${PYTHONWARNINGS:-}" in
        error* | *,error*)
            echo "env.sh: PYTHONWARNINGS is '$PYTHONWARNINGS', which turns warnings of libraries into errors; unset here" >&2
            unset PYTHONWARNINGS ;;
    esac

    # Other folders in PYTHONPATH come before this project's libraries: check that these still load
    case "$_plate_others" in
        "" | "$_plate_root"/install/* | /opt/ros/*) ;;
        *)
            if ! _plate_problem="$(python -c 'import numpy, scipy, cv2, yaml, rclpy' 2>&1)"; then
                echo "env.sh: PYTHONPATH is '$_plate_others', and with it Python cannot load the project's libraries:" >&2
                printf '%s\n' "$_plate_problem" | grep -E '^ *File|^[A-Za-z.]+(Error|Exception)' | tail -n 2 >&2
                echo "env.sh: run this command, and repeat: unset PYTHONPATH" >&2
                unset _plate_root _plate_shell _plate_others _plate_problem
                return 1 2>/dev/null || exit 1
            fi
            unset _plate_problem ;;
    esac

    # Numerics: the matrices are small, so threads would only get in each other's way
    export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
    export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
    unset _plate_root _plate_shell _plate_others
else
    echo "The workspace is not set up yet. Run: make -C '$_plate_root' setup" >&2
    unset _plate_root _plate_shell
    return 1 2>/dev/null || exit 1
fi
