"""One run of the demo, from its checked arguments to its pictures."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from record.bag import Recorder
from record.judge import judge, summary

from plate_bringup import GraphError, RunOptions, load_graph
from plate_core import PlateError, Rig, load_rig
from plate_core.tasks import AssembleTask, FollowTask, PoseTask, Scenario, load_scenario
from plate_driver.transports import check_transport
from plate_solver import METHODS

from .domains import own_domain
from .observer import Observer, Record
from .processes import Interrupted, ros_environment, signals_raise
from .session import Session, session

SILENCE_S = 30.0
"""Longest silence of the planner [s]."""

EXTRA_S = 30.0
"""Wall time beyond the scenario's time limit until we give up [s]: the planner should have."""

LOCKSTEP_SLOWER = 3
"""Lockstep may take this many times the task's own time on a slow machine."""

BAG = "bag"
OUTPUT = ("result.json", "strip.png", "demo.gif")


@dataclass(frozen=True)
class Plan:
    """What was asked for, checked.

    Attributes
    ----------
    options : RunOptions
    scenario : Scenario
    rig : Rig
    out : path
        Where results go.
    domain : int, optional
        ROS domain; if left out, one of its own.
    pictures : bool
    record : bool
        Whether to keep all messages.
    """

    options: RunOptions
    scenario: Scenario
    rig: Rig
    out: Path
    domain: int | None
    pictures: bool
    record: bool


def demo(args: argparse.Namespace) -> int:
    """Check the arguments, run, and return the exit code of tools/demo.py."""
    try:
        plan = checked(args)
    except PlateError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 2
    try:
        with signals_raise():
            return run(plan)
    except Interrupted as interrupt:
        print(f"\ndemo: {signal.Signals(interrupt.number).name}, all nodes are stopped", flush=True)
        return 128 + interrupt.number
    except PlateError as error:
        print(f"\ndemo: {error}", file=sys.stderr, flush=True)
        return 1


def checked(args: argparse.Namespace) -> Plan:
    """Check everything before anything is started.

    Raises
    ------
    PlateError
        Names the argument, its value and what is allowed.
    """
    scenario = load_scenario(args.scenario)
    if args.method not in METHODS:
        raise PlateError(f"method is {args.method!r}, allowed: {', '.join(sorted(METHODS))}")
    link = str((args.out / "device").absolute())
    check_transport(args.transport, args.port or link)
    if args.lockstep and args.transport == "serial":
        raise PlateError("lockstep with transport serial, allowed: sim (the device keeps time)")
    if not 0 <= args.seed < 2**31:
        raise PlateError(f"seed is {args.seed}, allowed: 0 to {2**31 - 1}")
    if args.domain is not None and not 0 <= args.domain <= 101:
        raise PlateError(f"domain is {args.domain}, allowed: 0 to 101")
    options = RunOptions(
        scenario=str(args.scenario),
        method=METHODS[args.method],
        seed=args.seed,
        transport=args.transport,
        port=args.port,
        link=link,
        lockstep=args.lockstep,
        autostart=False,
    )
    pictures = not args.no_pictures
    return Plan(options, scenario, load_rig(), args.out, args.domain, pictures, args.record)


def run(plan: Plan) -> int:
    """Run the task from start to end."""
    began = time.monotonic()
    clear(plan.out)
    names = [node.name for node in plan.options.nodes(load_graph())]
    print(
        f"{plan.scenario.description} Method: {plan.options.method}. "
        f"Gamma = {plan.rig.gamma:.1f}.\n"
        f"Starting {', '.join(names)} (the first time they compile: about a minute).",
        flush=True,
    )
    with running(plan) as graph:
        print(
            f"All {len(graph.nodes)} nodes seen after {time.monotonic() - began:.0f} s. "
            f"To look on: source env.sh; export ROS_DOMAIN_ID={os.environ['ROS_DOMAIN_ID']}",
            flush=True,
        )
        with recording(plan, graph.observer):
            graph.begin()
            watch(plan, graph.observer)
    record, codes = graph.observer.record, graph.processes.exit_codes
    result = judge(plan.rig, plan.options, record, graph.nodes, codes)
    result["wall_s"] = round(time.monotonic() - began, 1)
    print(summary(result), flush=True)
    write(plan.out / "result.json", result)
    if plan.pictures:
        draw(plan, record)
    if result["success"] and result["setpoints_within_limits"] and not any(codes.values()):
        return 0
    for name in (name for name, code in codes.items() if code):
        print(f"{name}:\n{graph.processes.tail(name)}", flush=True)
    return 1


@contextmanager
def running(plan: Plan) -> Iterator[Session]:
    """Run the graph, in a domain that programs started by us hear of too."""
    with own_domain(plan.domain) as domain:
        os.environ.update(ros_environment(domain))
        with session(plan.options, plan.out / "logs", domain) as graph:
            yield graph


@contextmanager
def recording(plan: Plan, observer: Observer) -> Iterator[None]:
    """Keep all messages meanwhile, if that was asked for."""
    if not plan.record:
        yield
        return
    with Recorder(observer.node, plan.out / BAG) as recorder:
        observer.pulses.append(recorder.discover)
        yield
    observer.pulses.remove(recorder.discover)
    print(f"\n  {plan.out / BAG}", flush=True)


def watch(plan: Plan, observer: Observer) -> None:
    """Show how the task gets on until it is over.

    Raises
    ------
    GraphError
        If the planner falls silent, or does not end the task in time.
    """
    line = ProgressLine(plan.scenario)
    record = observer.record
    allowed = plan.scenario.time_limit_s * (LOCKSTEP_SLOWER if plan.options.lockstep else 1)
    end = time.monotonic() + allowed + EXTRA_S
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
            raise GraphError(f"the task has not ended within {allowed + EXTRA_S:g} s")
    over = record.states[-1].split(":")[0]
    observer.until(lambda: record.last("planner", "task_state").startswith(over), 2.0)
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
        if (out / BAG).exists():
            shutil.rmtree(out / BAG)
    except OSError as problem:
        raise PlateError(f"out is {out}: {problem}") from None


def write(path: Path, result: dict[str, Any]) -> None:
    """Write the result."""
    path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(f"  {path}")


def draw(plan: Plan, record: Record) -> None:
    """Draw strip and animation, and say where they are."""
    from record.film import develop
    from record.pictures import Scene, draw_animation, draw_strip

    scene = Scene(plan.rig, plan.scenario, develop(record, plan.rig))
    title = f"{plan.scenario.name}, {plan.options.method}"
    strip, animation = plan.out / "strip.png", plan.out / "demo.gif"
    draw_strip(scene, strip, title)
    print(f"  {strip}", flush=True)
    draw_animation(scene, animation, title)
    print(f"  {animation}", flush=True)


class ProgressLine:
    """Rewrites itself on a terminal; elsewhere a new line every `QUIET_S`."""

    PERIOD_S = 0.25
    QUIET_S = 2.0

    def __init__(self, scenario: Scenario) -> None:
        self._following = isinstance(scenario.task, FollowTask)
        self._there = "placed" if isinstance(scenario.task, AssembleTask | PoseTask) else "sorted"
        self._terminal = sys.stdout.isatty()
        self._shown_at = 0.0

    def show(self, record: Record, last: bool = False) -> None:
        """Print what is known now; `last`: and end the line."""
        now = time.monotonic()
        if self._terminal:
            print(f"\r\033[K  {self.text(record)}", end="\n" if last else "", flush=True)
        elif last or now - self._shown_at >= self.QUIET_S:
            self._shown_at = now
            print(f"  {self.text(record)}", flush=True)

    def text(self, record: Record) -> str:
        """Return the line."""
        if not record.last("planner", "time_s"):
            return "waiting for the first image"
        if self._following:
            done = f"error {1e3 * float(record.last('planner', 'rms_error_m')):.2f} mm rms"
        else:
            done = f"{record.last('planner', 'parts_sorted')}/" + record.last(
                "planner", "parts_total"
            )
            done += f" parts {self._there}"
        missed = 100 * float(record.last("solver", "missed_fraction", "0"))
        return (
            f"{done} | {float(record.last('planner', 'time_s')):5.1f} s"
            f" | force missed {missed:3.0f} %"
            f" | solve {float(record.last('solver', 'solve_ms_median', '0')):3.0f} ms"
        )
