"""Run a task with the real nodes as processes, evaluate it, and draw pictures of it.

python tools/demo.py --scenario sort_10 --method sinusoids

Exit code 0: the task succeeded, no part was dropped, all limits were kept, and all nodes ended with
code 0. 1: one of these failed. 2: invalid arguments, nothing was started. 130: interrupted, the
results so far are kept.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path


def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    # Until nodes are started, Ctrl-C ends this program at once, also during an import.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from plate_core import PlateError, load_rig
    from plate_core.tasks import load_scenario

    try:  # report a mistyped name before the slow imports
        load_rig(args.rig or load_scenario(args.scenario).rig)
    except PlateError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    from graph.demo import demo

    return demo(args)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="make demo",
        description="Run a task on the vibrating plate: ROS 2 nodes as processes of their "
        "own, in a ROS domain of their own, driven only by what the camera sees.",
        epilog="With make: make demo SCENARIO=sort_10 RIG=my_rig.yaml METHOD=rotations "
        "CAMERA=/dev/video0 PORT=/dev/ttyACM0 ARGS='--seed 3'. Ctrl-C ends it and keeps the "
        "results so far.",
    )
    add = parser.add_argument
    add("--scenario", default="sort_10", help="name in config/scenarios or .yaml file (sort_10)")
    add("--rig", default="", help="name in config/rigs or .yaml file (the scenario's)")
    add("--method", default="sinusoids", help="rotations (A) or sinusoids (B, the default)")
    add(
        "--transport",
        default="",
        help="motors: sim, serial, cia402 or odrive (serial with a port or camera)",
    )
    add("--port", default="", help="of a motor controller; serial without one: a simulated one")
    add(
        "--camera",
        default="",
        help="device of your camera, as `camera --list` shows it, or a film; with a port and no "
        "camera, another node publishes the images",
    )
    add("--seed", type=int, default=0, help="where parts are scattered, image noise (0)")
    add("--lockstep", action="store_true", help="as fast as it goes: simulated time waits for all")
    add(
        "--image-rate",
        type=float,
        default=0.0,
        help="images a second of a simulated camera that runs free (0: one at each cycle's start)",
    )
    add("--one-process", action="store_true", help="all nodes in one process")
    add("--domain", type=int, help="ROS domain, 0 to 101 (a free one; with a port ROS_DOMAIN_ID)")
    add("--out", type=Path, help="folder of results (out/demo-TIME_SCENARIO; out/demo links to it)")
    add(
        "--record", action="store_true", help="keep all messages, for Foxglove or ros2 bag: OUT/bag"
    )
    add("--picks", type=int, default=20, help="parts that a robot takes, with a feeder (20)")
    add("--robot-cycle", type=float, default=2.0, help="seconds that it needs for one (2)")
    add("--no-view", action="store_true", help="without the live page in a browser")
    add("--no-pictures", action="store_true", help="write result.json only")
    args = parser.parse_args()
    args.transport = args.transport or ("serial" if args.port or args.camera else "sim")
    return args


if __name__ == "__main__":
    sys.exit(main())
