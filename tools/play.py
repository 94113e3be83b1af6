"""Run the graph with the simulator and the live page, for interactive use, until Ctrl-C.

python tools/play.py [--scenario play] [--rig desk] [--bag out/demo/bag]

A page that ends unexpectedly is started again. Exit code 0 after Ctrl-C; 1 if a node has ended
unexpectedly; 2 if the arguments are invalid and nothing was started.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

PAGE_S = 30.0
"""Maximum wait until the page has started [s]."""

POLL_S = 0.5
"""Interval at which the program checks that all nodes run [s]."""


def main() -> int:
    """Run the command line. Return its exit code."""
    args = arguments()
    # until nodes are started, Ctrl-C ends the program immediately
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from graph.processes import Interrupted, signals_raise

    from plate_core import PlateError

    try:
        options = check_arguments(args)
    except PlateError as error:
        print(f"play: {error}", file=sys.stderr)
        return 2
    try:
        with signals_raise(), TemporaryDirectory(prefix="plate_play_") as folder:
            if args.bag:
                replay(options, args.bag, Path(folder), args.domain)
            else:
                play(options, Path(folder), args.domain)
    except Interrupted:
        print("\nplay: all nodes are stopped", flush=True)
    except PlateError as error:
        print(f"\nplay: {error}", file=sys.stderr, flush=True)
        return 1
    return 0


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        prog="make play",
        description="Run the simulated plate, or yours, with a live page: drag a part, and it goes "
        "there.",
        epilog="With make: make play SCENARIO=align_6 RIG=desk ARGS='--seed 3'. Ctrl-C ends it.",
    )
    add = parser.add_argument
    add(
        "--scenario",
        default="play",
        help="scenario of the parts: name or .yaml file; default: play",
    )
    add("--rig", default="", help="name in config/rigs, or .yaml file; default: the scenario's rig")
    add(
        "--method",
        default="sinusoids",
        help="method of the solver: rotations (A) or sinusoids (B); default: sinusoids",
    )
    add("--seed", type=int, default=0, help="random seed of the parts' places; default: 0")
    add(
        "--simulated-time",
        action="store_true",
        help="use simulated time, so that the page can change the rate",
    )
    add(
        "--port",
        default="",
        help="port of a motor controller; default with a camera: a simulated controller",
    )
    add("--camera", default="", help="device of your camera as in `camera --list`, or a video")
    add("--bag", default="", help="folder of a recorded run to show, without starting a graph")
    add("--domain", type=int, help="ROS domain, 0 to 101; default: a free one")
    return parser.parse_args()


def check_arguments(args: argparse.Namespace):
    """Check all arguments before anything is started, and return the options of the run.

    Raises
    ------
    PlateError
        If an argument is invalid. The message contains the argument, its value and the allowed
        values.
    """
    from plate_core import PlateError, load_rig
    from plate_core.tasks import load_scenario, start_positions

    scenario = load_scenario(args.scenario)
    rig = args.rig or scenario.rig
    # load the rig now, so that a wrong file name is reported before the slow imports
    known = load_rig(rig)

    import numpy as np
    from graph.demo import absolute_path, check_camera, check_run, print_unmeasured

    from plate_bringup import RunOptions
    from plate_solver import METHODS

    check_run(args)
    if args.bag and not Path(args.bag).is_dir():
        raise PlateError(f"bag is {args.bag!r}, allowed: the folder of a recorded run")
    start_positions(scenario, known, np.random.default_rng(args.seed))
    real = bool(args.port or args.camera)
    if real and args.simulated_time:
        raise PlateError("simulated time with a port or a camera, allowed: real time")
    check_camera(args.camera, args.port)
    if real:
        print_unmeasured("play", known, args.port)
    return RunOptions(
        scenario=absolute_path(args.scenario), method=METHODS[args.method], seed=args.seed,
        rig_file=absolute_path(rig), simulated_time=args.simulated_time, view=True,
        transport="serial" if real else "sim", port=args.port, camera=args.camera,
    )  # fmt: skip


def play(options, folder: Path, domain: int | None) -> None:
    """Start the graph, print the address of the page, and wait for Ctrl-C.

    Raises
    ------
    GraphError
        If a node ends or does not answer, or if the page does not start.
    """
    from graph.demo import WAITING_S, StatusLine, running

    from plate_bringup import GraphError

    with running(options, folder, domain, StatusLine(WAITING_S), pictures=False) as graph:
        page = graph.page()
        if not page:
            raise GraphError(f"the page does not start\n{graph.processes.tail('page')}")
        enable = "enable the motors there, then " if options.transport == "serial" else ""
        print(
            f"Open {page} in a browser: {enable}drag a part. Ctrl-C ends it.\n"
            f"To watch with ROS: source env.sh; export ROS_DOMAIN_ID={graph.observer.domain}",
            flush=True,
        )
        keep_page(graph.processes, graph.observer, page)


def keep_page(processes, observer, page: str) -> None:
    """Start the page again at the same address whenever it ends, until it has ended `MAX_ENDS`
    times within `WITHIN_S`.

    Raises
    ------
    GraphError
        If another node ends.
    """
    from urllib.parse import urlsplit

    from graph.processes import MAX_ENDS, WITHIN_S, Ends

    ends, given_up = Ends(), False
    while True:
        observer.until(lambda: False, POLL_S)
        end = "" if given_up else processes.end_of("page")
        if end:
            given_up = ends.too_many(time.monotonic())
            then = (
                f"It has ended {MAX_ENDS} times within {WITHIN_S:.0f} s and is not restarted."
                " The graph continues; Ctrl-C ends it."
                if given_up
                else "It is restarted; the graph continues, and the browser reconnects by itself."
            )
            print(f"play: {end}\n{then}", file=sys.stderr, flush=True)
            if not given_up:
                processes.restart("page", "-p", f"port:={urlsplit(page).port}")
        elif (now := observer.record.last("page", "url")) != page:
            page = now
            print(f"The page is at {page} now.", flush=True)


def replay(options, bag: str, folder: Path, domain: int | None) -> None:
    """Show a recorded run on the page, without a graph, until Ctrl-C.

    Raises
    ------
    GraphError
        If the page ends.
    """
    from graph.domains import own_domain
    from graph.observer import Observer
    from graph.processes import ROS_ARGS, Processes, executable

    from plate_core import config_path

    command = [str(executable("plate_view", "page")), *ROS_ARGS, str(config_path("nodes.yaml"))]
    command += ["-p", f"bag:={json.dumps(str(Path(bag).absolute()))}"]
    command += ["-p", f"rig_file:={json.dumps(options.rig_file)}"]
    with own_domain(domain) as number, Processes((), options, folder, number) as nodes:
        nodes.add({"page": command})
        with Observer(number, nodes.check, pictures=False) as observer:
            observer.until(lambda: bool(observer.record.last("page", "url")), PAGE_S)
            print(f"Open {observer.record.last('page', 'url')} in a browser. Ctrl-C ends it.")
            while True:
                observer.until(lambda: False, POLL_S)


if __name__ == "__main__":
    sys.exit(main())
