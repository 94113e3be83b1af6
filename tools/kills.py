"""Kill each node of the graph in mid-task with SIGKILL, start it again, and see what becomes of it.

python tools/kills.py [NODE ...] [--scenario sort_4] [--json FILE]

One task, one node after the other. For each: how many plate cycles were begun in motion after the
first one that could not be a new one, until the plate rested; how long until it moved again after
the node came back; at the end, how the task ended and whether a motor table broke a limit.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml
from graph.film import check_limits
from graph.observer import Observer
from graph.processes import Processes, free_domain
from trajectory_msgs.msg import JointTrajectory

from plate_core import load_rig
from plate_core.graph import RunOptions, load_graph
from plate_core.rig import config_path
from plate_core.ros.convert import msg_to_motors

START_S, REST_S, RETURN_S, END_S = 180.0, 20.0, 60.0, 240.0
"""Longest waits [s]: until the graph stands, the plate rests, moves again, the task is over."""


class Watch:
    """When the last moving table and the last resting one came, and how long the former is."""

    def __init__(self, observer: Observer) -> None:
        self.observer, self.rig = observer, load_rig()
        self.moving = False
        self.moved_at = self.rested_at = 0.0
        self.period = 0.0
        observer.node.create_subscription(JointTrajectory, "motor_setpoints", self._on_table, 50)

    def _on_table(self, msg: JointTrajectory) -> None:
        cycle = msg_to_motors(self.rig, msg)
        was, self.moving = self.moving, bool(cycle.knot_pose.any())
        if self.moving:
            self.moved_at, self.period = time.monotonic(), cycle.period
        elif was:
            self.rested_at = time.monotonic()


def kill(name: str, processes: Processes, watch: Watch, hold: int) -> dict[str, Any]:
    """Kill one node and start it again."""
    observer, record = watch.observer, watch.observer.record
    assert observer.until(lambda: watch.moving, RETURN_S), f"before {name}: the plate does not move"
    truths = len(record.truth)
    processes.signal(name, signal.SIGKILL)
    processes.wait(name, 5.0)
    if name == "driver":  # nobody is left to say so: the simulated device holds, then rests
        observer.until(lambda: len(record.truth) > truths + hold + 3, REST_S)
        cycles = float("nan")
        watch.moving = False
    else:
        rested = observer.until(lambda: not watch.moving, REST_S)
        assert rested, f"{name}: the plate goes on"
        # Noticed when `hold` periods have gone by without a cycle; then the rest table is played
        # from the next boundary on.
        late = watch.rested_at - watch.moved_at - hold * watch.period
        cycles = late / watch.period + 1
    processes.restart(name)
    began = time.monotonic()
    if name == "planner":
        observer.until(lambda: name in observer.seen([name]), RETURN_S)
        observer.until(lambda: False, 1.0)
        observer.trigger("start")
    returned = observer.until(lambda: watch.moving or record.ended, RETURN_S)
    return {
        "node": name, "cycles_to_rest": round(cycles, 2),
        "moves_again": returned, "back_s": round(time.monotonic() - began, 1),
    }  # fmt: skip


def run(names: list[str], scenario: str, logs: Path) -> dict[str, Any]:
    """Kill nodes in one task; return what happened."""
    domain, graph = free_domain(), load_graph()
    config = yaml.safe_load(config_path("nodes.yaml").read_text(encoding="utf-8"))
    hold = int(config["/**/driver"]["ros__parameters"]["hold_cycles"])
    rows = []
    with (
        Processes(graph, RunOptions(scenario=scenario), logs, domain) as processes,
        Observer(domain) as observer,  # without a look at the processes: they are to die
    ):
        observer.await_nodes([node.name for node in graph], START_S)
        observer.await_answers(START_S)
        watch = Watch(observer)
        observer.trigger("start")
        for name in names:
            rows.append(kill(name, processes, watch, hold))
            print(rows[-1], flush=True)
            # Some seconds of work, so that the next one dies in mid-task too.
            observer.until(lambda: observer.record.ended, 3.0)
        observer.until(lambda: observer.record.ended, END_S)
        state = observer.record.states[-1]
        check = check_limits(observer.record, load_rig())
    return {
        "rows": rows, "ended": state, "tables": check.tables, "faults": list(check.faults),
    }  # fmt: skip


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [node.name for node in load_graph()]
    parser.add_argument("nodes", nargs="*", choices=[*names, []], help="all if left out")
    parser.add_argument("--scenario", default="sort_4")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as logs:
        result = run(args.nodes or names, args.scenario, Path(logs))
    print(f"task: {result['ended']}; {result['tables']} motor tables, faults: {result['faults']}")
    if args.json:
        args.json.write_text(json.dumps(result, indent=1), encoding="utf-8")
    well = result["ended"].startswith("done") and not result["faults"]
    return 0 if well and all(row["moves_again"] for row in result["rows"]) else 1


if __name__ == "__main__":
    sys.exit(main())
