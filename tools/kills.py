"""Kill each node of the graph in mid-task with SIGKILL, start it again, and see what becomes of it.

python tools/kills.py [NODE ...] [--scenario sort_10] [--json FILE]

A task for each, with the parts put down anew. For how many cycles the plate moved the parts after
the loss could be seen, that is `hold_cycles` periods after the last table; how long until the plate
moved again after the node came back, and how the task ended; whether a table broke a limit.
"""

from __future__ import annotations

import argparse
import json
import math
import os
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
from sensor_msgs.msg import MultiDOFJointState
from trajectory_msgs.msg import JointTrajectory

from plate_core import load_rig
from plate_core.graph import RunOptions, load_graph
from plate_core.rig import config_path
from plate_core.ros.convert import msg_to_motors, seconds

START_S, REST_S, RETURN_S, END_S = 180.0, 20.0, 60.0, 240.0
"""Longest waits [s]: until the graph stands, the plate rests, moves again, the task is over."""

WORK_S = 5.0
"""Time for which the plate moves before a node is killed [s]."""

MOST_CYCLES = 2.0
"""Cycles after which the plate must rest."""


class Watch:
    """When the last moving table came, and since when the plate has rested. Times in [s], UTC."""

    def __init__(self, observer: Observer) -> None:
        self.observer, self.rig = observer, load_rig()
        self.moving = False
        self.sent_at = self.rest_sent_at = self.rests_since = self.seen_at = 0.0
        self.period = 0.0
        listen = observer.node.create_subscription
        listen(JointTrajectory, "motor_setpoints", self._on_table, 50)
        listen(MultiDOFJointState, "ground_truth", self._on_truth, 50)

    def _on_table(self, msg: JointTrajectory) -> None:
        cycle = msg_to_motors(self.rig, msg)
        was, self.moving = self.moving, bool(cycle.knot_pose.any())
        if self.moving:
            self.sent_at, self.period = time.time(), cycle.period
        elif was:
            self.rest_sent_at = time.time()

    def _on_truth(self, msg: MultiDOFJointState) -> None:
        before, self.seen_at = self.seen_at, seconds(msg.header.stamp)
        if any(twist.linear.x or twist.linear.y for twist in msg.twist):
            self.rests_since = math.inf
        elif self.rests_since == math.inf:  # they came to rest in the cycle that ends now
            self.rests_since = before

    @property
    def resting(self) -> bool:
        """Whether the plate has rested for three cycles, as the parts on it show."""
        return self.seen_at - self.rests_since > 3 * self.period


def kill(name: str, processes: Processes, watch: Watch, hold: int) -> dict[str, Any]:
    """Kill one node and start it again."""
    observer, record = watch.observer, watch.observer.record
    observer.begin_anew()
    assert observer.until(lambda: watch.moving, RETURN_S), f"before {name}: {record.states}"
    observer.until(lambda: record.ended, WORK_S)
    assert not record.ended, f"before {name}: {record.states}"
    late = float(record.last("simulator", "late cycles", "0"))
    processes.signal(name, signal.SIGKILL)
    processes.wait(name, 5.0)
    # The loss shows when `hold` periods have gone by without a cycle.
    if name == "simulator":  # nobody is left to be moved: the rest table would be played at once
        rested = observer.until(lambda: not watch.moving, REST_S)
        until = watch.rest_sent_at + watch.period
    else:
        rested = observer.until(lambda: watch.resting, REST_S)
        until = watch.rests_since
    assert rested, f"{name}: the plate goes on"
    cycles = (until - watch.sent_at) / watch.period - hold
    late = float(record.last("simulator", "late cycles", "0")) - late
    processes.restart(name)
    began = time.monotonic()
    watch.moving = False
    if name == "planner":
        # The dead one is still in the graph; the new one says that it is idle.
        observer.until(lambda: record.states[-1] == "idle", RETURN_S)
        observer.until(lambda: False, 1.0)
        observer.trigger("start")
    observer.until(lambda: watch.moving, RETURN_S)
    back = time.monotonic() - began
    observer.until(lambda: record.ended, END_S)
    return {
        "node": name, "cycles_to_rest": round(cycles, 2), "late_cycles": int(late),
        "back_s": round(back, 1), "ended": record.states[-1], "load": round(os.getloadavg()[0], 1),
    }  # fmt: skip


def run(names: list[str], scenario: str, logs: Path) -> dict[str, Any]:
    """Kill nodes in one task; return what happened."""
    options, domain = RunOptions(scenario=scenario), free_domain()
    graph = options.nodes(load_graph())
    config = yaml.safe_load(config_path("nodes.yaml").read_text(encoding="utf-8"))
    hold = int(config["/**/driver"]["ros__parameters"]["hold_cycles"])
    rows = []
    with (
        Processes(graph, options, logs, domain) as processes,
        Observer(domain) as observer,  # without a look at the processes: they are to die
    ):
        observer.await_nodes([node.name for node in graph], START_S)
        observer.await_answers(START_S)
        watch = Watch(observer)
        for name in names:
            rows.append(kill(name, processes, watch, hold))
            print(rows[-1], flush=True)
        check = check_limits(observer.record, load_rig())
    return {"rows": rows, "tables": check.tables, "faults": list(check.faults)}


def main() -> int:
    """Run the command line; returns its exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = [node.name for node in RunOptions().nodes(load_graph())]
    parser.add_argument("nodes", nargs="*", choices=[*names, []], help="all if left out")
    parser.add_argument("--scenario", default="sort_10")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as logs:
        result = run(args.nodes or names, args.scenario, Path(logs))
    print(f"{result['tables']} motor tables, faults: {result['faults']}")
    if args.json:
        args.json.write_text(json.dumps(result, indent=1), encoding="utf-8")
    well = all(
        row["ended"] == "done" and row["cycles_to_rest"] <= MOST_CYCLES for row in result["rows"]
    )
    return 0 if well and not result["faults"] else 1


if __name__ == "__main__":
    sys.exit(main())
