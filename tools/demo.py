"""The demo: five real nodes in five processes close the loop; we watch, judge and draw.

python tools/demo.py --scenario sort_10 --method sinusoids

Exit code 0: the task succeeded, nothing was dropped, all limits were kept, all nodes ended well.
1: it did not. 2: wrong arguments, nothing was started. 130: interrupted.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graph.observer import Observer
from graph.processes import Interrupted, free_domain, ros_environment, signals_raise
from graph.progress import ProgressLine
from graph.record import Record
from graph.result import judge, summary
from graph.session import session

from plate_core import PlateError, Rig, load_rig
from plate_core.graph import GraphError, RunOptions, load_graph
from plate_core.scenario import Scenario, load_scenario
from plate_driver.transport import check_transport
from plate_solver.controller import METHODS

SILENCE_S = 30.0
"""Longest silence of the planner [s]."""

EXTRA_S = 30.0
"""Wall time beyond the scenario's time limit until we give up [s]: the planner should have."""

OUTPUT = ("result.json", "strip.png", "demo.gif")


@dataclass(frozen=True)
class Demo:
    """What was asked for, checked.

    Attributes
    ----------
    options : RunOptions
    scenario : Scenario
    rig : Rig
    out : path
        Where results go.
    domain : int
        ROS domain.
    pictures : bool
    """

    options: RunOptions
    scenario: Scenario
    rig: Rig
    out: Path
    domain: int
    pictures: bool


def main() -> int:
    """Run the command line; returns its exit code."""
    try:
        demo = checked(arguments())
    except PlateError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    try:
        with signals_raise():
            return run(demo)
    except Interrupted as interrupt:
        print(f"\ndemo: {signal.Signals(interrupt.number).name}, all nodes are stopped", flush=True)
        return 128 + interrupt.number
    except PlateError as error:
        print(f"\ndemo: {error}", file=sys.stderr, flush=True)
        return 1


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog="make demo",
        description="Run a task on the vibrating plate: five ROS 2 nodes as processes of their "
        "own, in a ROS domain of their own, driven only by what the camera sees.",
        epilog="With make: make demo SCENARIO=sort_10 METHOD=rotations ARGS='--seed 3'",
    )
    add = parser.add_argument
    add("--scenario", default="sort_10", help="name in config/scenarios or .yaml file (sort_10)")
    add("--method", default="sinusoids", help="rotations (A) or sinusoids (B, the default)")
    add("--transport", default="sim", help="what moves the plate: sim (default) or serial")
    add("--seed", type=int, default=0, help="where parts are scattered, image noise (0)")
    add("--lockstep", action="store_true", help="as fast as it goes: simulated time waits for all")
    add("--domain", type=int, help="ROS domain, 0 to 101 (a free one)")
    add("--out", type=Path, default=Path("out/demo"), help="folder for the results (out/demo)")
    add("--no-pictures", action="store_true", help="write result.json only")
    return parser.parse_args()


def checked(args: argparse.Namespace) -> Demo:
    """Check everything before anything is started.

    Raises
    ------
    PlateError
        Names the argument, its value and what is allowed.
    """
    scenario = load_scenario(args.scenario)
    if args.method not in METHODS:
        raise PlateError(f"method is {args.method!r}, allowed: {', '.join(sorted(METHODS))}")
    check_transport(args.transport)
    if not 0 <= args.seed < 2**31:
        raise PlateError(f"seed is {args.seed}, allowed: 0 to {2**31 - 1}")
    if args.domain is not None and not 0 <= args.domain <= 101:
        raise PlateError(f"domain is {args.domain}, allowed: 0 to 101")
    options = RunOptions(
        scenario=str(args.scenario),
        method=METHODS[args.method],
        seed=args.seed,
        transport=args.transport,
        lockstep=args.lockstep,
        autostart=False,
    )
    domain = free_domain() if args.domain is None else args.domain
    return Demo(options, scenario, load_rig(), args.out, domain, not args.no_pictures)


def run(demo: Demo) -> int:
    """Run the task from start to end."""
    began = time.monotonic()
    clear(demo.out)
    for name, value in ros_environment(demo.domain).items():
        os.environ.setdefault(name, value)
    names = [node.name for node in demo.options.nodes(load_graph())]
    print(
        f"{demo.scenario.description} Method: {demo.options.method}. "
        f"Gamma = {demo.rig.gamma:.1f}.\n"
        f"Starting {', '.join(names)} (the first time they compile: about a minute).",
        flush=True,
    )
    with session(demo.options, demo.out / "logs", demo.domain) as graph:
        print(
            f"All {len(graph.nodes)} nodes seen after {time.monotonic() - began:.0f} s. "
            f"To look on: export ROS_DOMAIN_ID={demo.domain}",
            flush=True,
        )
        graph.begin()
        watch(demo, graph.observer)
    record, codes = graph.observer.record, graph.processes.exit_codes
    result = judge(demo.rig, demo.options, record, graph.nodes, codes)
    result["wall_s"] = round(time.monotonic() - began, 1)
    write(demo.out / "result.json", result)
    print(summary(result), flush=True)
    if demo.pictures:
        draw(demo, record)
    if result["success"] and result["setpoints_within_limits"] and not any(codes.values()):
        return 0
    for name in (name for name, code in codes.items() if code):
        print(f"{name}:\n{graph.processes.tail(name)}", flush=True)
    return 1


def watch(demo: Demo, observer: Observer) -> None:
    """Show how the task gets on until it is over.

    Raises
    ------
    GraphError
        If the planner falls silent, or does not end the task in time.
    """
    line = ProgressLine(demo.scenario)
    record = observer.record
    end = time.monotonic() + demo.scenario.time_limit_s + EXTRA_S
    count, news = 0, time.monotonic()
    while not record.ended:
        observer.until(lambda: record.ended, line.PERIOD_S)
        line.show(record)
        now = time.monotonic()
        if len(record.reports["planner"]) > count:
            count, news = len(record.reports["planner"]), now
        if now - news > SILENCE_S:
            raise GraphError(f"the planner has said nothing for {SILENCE_S:g} s")
        if now > end:
            raise GraphError(f"the task has not ended {EXTRA_S:g} s after its time limit")
    over = record.states[-1].split(":")[0]
    observer.until(lambda: record.last("planner", "message").startswith(over), 2.0)
    line.show(record, last=True)


def clear(out: Path) -> None:
    """Make the folder and remove an earlier run's results, so that none are taken for ours.

    Raises
    ------
    PlateError
        If that cannot be done.
    """
    try:
        (out / "logs").mkdir(parents=True, exist_ok=True)
        for path in [*(out / name for name in OUTPUT), *(out / "logs").glob("*.log")]:
            path.unlink(missing_ok=True)
    except OSError as problem:
        raise PlateError(f"out is {out}: {problem}") from None


def write(path: Path, result: dict[str, Any]) -> None:
    """Write the result."""
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(f"  {path}")


def draw(demo: Demo, record: Record) -> None:
    """Draw strip and animation, and say where they are."""
    from graph.film import develop
    from graph.pictures import Scene, draw_animation, draw_strip

    scene = Scene(demo.rig, demo.scenario, develop(record, demo.rig))
    title = f"{demo.scenario.name}, {demo.options.method}"
    strip, animation = demo.out / "strip.png", demo.out / "demo.gif"
    draw_strip(scene, strip, title)
    print(f"  {strip}", flush=True)
    draw_animation(scene, animation, title)
    print(f"  {animation}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
