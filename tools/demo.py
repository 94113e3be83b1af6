"""Run a task with the real nodes as processes, evaluate it, and draw pictures of it.

python tools/demo.py --scenario sort_10 --method sinusoids

Exit code 0: the task succeeded, no part was dropped, all limits were kept, and all nodes ended with
code 0. Exit code 1: one of these conditions is not met. Exit code 2: an argument is invalid, and
nothing was started. Exit code 130: the run was interrupted, and the results so far are kept.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path


def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    # Until nodes are started, Ctrl-C ends this program immediately, also during an import.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from plate_core import PlateError, load_rig
    from plate_core.tasks import load_scenario

    try:  # load the files now, so that a wrong file name is reported before the slow imports
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
        description="Run a task on the vibrating plate. The ROS 2 nodes are separate processes in "
        "a separate ROS domain, and only the camera's images control them.",
        epilog="With make: make demo SCENARIO=sort_10 RIG=my_rig.yaml METHOD=rotations "
        "CAMERA=/dev/video0 PORT=/dev/ttyACM0 ARGS='--seed 3'. Ctrl-C ends the run and keeps its "
        "results.",
    )
    add = parser.add_argument
    add(
        "--scenario",
        default="sort_10",
        help="name in config/scenarios or .yaml file; default: sort_10",
    )
    add("--rig", default="", help="name in config/rigs or .yaml file; default: the scenario's rig")
    add(
        "--method",
        default="sinusoids",
        help="method of the solver: rotations (A) or sinusoids (B); default: sinusoids",
    )
    add(
        "--transport",
        default="",
        help="transport to the motors: sim, serial, cia402 or odrive; default: serial with a port "
        "or camera, otherwise sim",
    )
    add(
        "--port",
        default="",
        help="port of a motor controller; default with serial: a simulated controller",
    )
    add(
        "--camera",
        default="",
        help="device of your camera as in `camera --list`, or a video; default with a port: "
        "another node publishes the images",
    )
    add(
        "--seed",
        type=int,
        default=0,
        help="random seed of the parts' places and of noise; default: 0",
    )
    add(
        "--lockstep",
        action="store_true",
        help="run as fast as possible: simulated time waits for all nodes",
    )
    add(
        "--image-rate",
        type=float,
        default=0.0,
        help="images per second of a free-running simulated camera; default: 0, which takes one "
        "image at the start of each cycle",
    )
    add("--one-process", action="store_true", help="run all nodes in one process")
    add(
        "--domain",
        type=int,
        help="ROS domain, 0 to 101; default: a free one, or ROS_DOMAIN_ID with a port",
    )
    add(
        "--out",
        type=Path,
        help="folder of results; default: out/demo-TIME_SCENARIO, to which out/demo links",
    )
    add("--record", action="store_true", help="record all messages in OUT/bag (Foxglove, ros2 bag)")
    add(
        "--picks",
        type=int,
        default=20,
        help="with a task of kind feed: number of parts that the robot takes; default: 20",
    )
    add(
        "--robot-cycle",
        type=float,
        default=2.0,
        help="with a task of kind feed: time between two picks of the robot [s]; default: 2",
    )
    add("--no-view", action="store_true", help="do not start the live page")
    add("--no-pictures", action="store_true", help="write only result.json, and draw no pictures")
    args = parser.parse_args()
    args.transport = args.transport or ("serial" if args.port or args.camera else "sim")
    return args


if __name__ == "__main__":
    sys.exit(main())
