"""Freeze nodes of the graph at random, one or two at the same time, and check the age of every
motor table.

A node is frozen (SIGSTOP) for 0.1 to 5 s: during a task, while it is stopped, or after an emergency
stop. A fraction `--kills` of the faults kills the node (SIGKILL) and starts it again. The check
uses only the stamps and publication times of the driver's tables. A table that moves the plate is
wrong in three cases. The table's image is older than `age_limit`, the image is older than the last
emergency stop, or the table's task had already ended. With `--image_rate`, the camera is
free-running. The stamp of a table is then the start of a cycle, and the newest `parts` can be older
by another `age_limit`. Exit code 1 if a table was wrong.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from graph.hops import Listener
from graph.observer import ALL, Observer
from graph.processes import Processes
from graph.session import START_S, session
from trajectory_msgs.msg import JointTrajectory

from cases import Outcome
from plate_bringup import GraphError, RunOptions
from plate_core.ros import LATCHED, nanoseconds
from plate_core.status import age_limit
from plate_core.tasks import Scenario
from plate_interfaces.msg import Parts, TaskStatus

FREEZE_S, PAUSE_S = (0.1, 5.0), (0.2, 1.5)
"""Ranges of a freeze's duration, and of the time between two freezes [s]."""

STOPS = 0.1
"""Fraction of the freezes during which a task is stopped. During the same fraction of the freezes,
an emergency stop is called."""

NOTICE_S = 0.1
"""Maximum delay until the driver has received the end of a task [s]. This maximum does not apply to
a frozen driver."""

DEAD_S = (0.5, 3.0)
"""Range of the time until a killed node is started again [s]."""


class FaultRecorder(Listener):
    """Receives motor tables, ends of tasks and parts with their publication times, and collects the
    wrong tables."""

    def __init__(self) -> None:
        super().__init__("judge")
        self.tables = self.moving = 0
        self.oldest_s = 0.0
        self.wrong: list[str] = []
        self.away: list[str] = []  # names of the nodes that were frozen last
        # For each end of a task: publication time [ns], and stamp of the last answered image [ns].
        self.ends: list[tuple[int, int]] = []
        self.stopped_ns = self._seen_ns = 0
        listen: Any = self.node.create_subscription
        listen(JointTrajectory, "motor_setpoints", self._on_table, ALL)
        listen(TaskStatus, "task_status", self._on_task, LATCHED)
        listen(Parts, "parts", self._on_parts, ALL)

    def _on_task(self, msg: TaskStatus, info: Any) -> None:
        if msg.state not in (TaskStatus.RUNNING, TaskStatus.IDLE):
            self.ends.append((info["source_timestamp"], nanoseconds(msg.header.stamp)))

    def _on_parts(self, msg: Parts) -> None:
        self._seen_ns = nanoseconds(msg.header.stamp)

    def _on_table(self, msg: JointTrajectory, info: Any) -> None:
        self.tables += 1
        if not any(any(point.positions) for point in msg.points):
            return
        self.moving += 1
        stamp, sent = nanoseconds(msg.header.stamp), info["source_timestamp"]
        age = 1e-9 * (sent - stamp)
        limit = age_limit(1e-9 * nanoseconds(msg.points[-1].time_from_start))
        blind = 1e-9 * (sent - self._seen_ns)
        self.oldest_s = max(self.oldest_s, age)
        ended = [
            ended_ns
            for ended_ns, last in self.ends
            if stamp <= last and ended_ns + 1e9 * NOTICE_S < sent
        ]
        for wrong, why in (
            (age > limit, f"{age:.3f} s old"),
            (blind > 2 * limit, f"{blind:.3f} s after the newest image"),
            (stamp < self.stopped_ns < sent, "requested before an emergency stop"),
            (bool(ended), f"{1e-9 * (sent - max(ended, default=0)):.2f} s after its task's end"),
        ):
            if wrong:
                self.wrong.append(f"{why}; frozen last: {', '.join(self.away)}")
                print(f"WRONG: a moving table {self.wrong[-1]}", flush=True)


def freeze(processes: Processes, observer: Observer, durations: dict[str, float]) -> None:
    """Freeze nodes at the same time. `durations` contains the duration of the freeze for each node
    [s]."""
    begun = time.monotonic()
    for name in durations:
        processes.signal(name, signal.SIGSTOP)
    for name, seconds in sorted(durations.items(), key=lambda item: item[1]):
        observer.until(lambda: False, max(0.0, begun + seconds - time.monotonic()))
        processes.signal(name, signal.SIGCONT)


def begin_task(observer: Observer, scenario: Scenario) -> bool:
    """Enable the motors if they are off, and start the task again. Return False if it cannot be
    started, for example because a node is still stopped on a busy computer."""
    try:
        if not observer.record.ready:
            observer.enable()
        observer.restart(scenario)
    except GraphError as error:
        print(f"no task: {error}", flush=True)
        return False
    return True


def kill_and_restart(processes: Processes, observer: Observer, name: str, pause_s: float) -> None:
    """Kill a node, and start it again after `pause_s` [s]."""
    processes.signal(name, signal.SIGKILL)
    processes.wait(name, DEAD_S[1])
    observer.until(lambda: False, pause_s)
    processes.restart(name)


def run(
    logs: Path,
    count: int = 500,
    minutes: float = math.inf,
    kills: float = 0.0,
    seed: int = 0,
    image_rate: float = 0.0,
) -> Iterator[Outcome]:
    """Freeze and kill nodes at random, `count` times or for `minutes`."""
    options = RunOptions(image_rate=image_rate)
    rng = np.random.default_rng(seed)
    tasks = trouble = 0
    frozen, killed, began = Counter[str](), Counter[str](), time.monotonic()
    with (
        session(options, logs, pictures=False, watched=False) as graph,
        FaultRecorder() as faults,
    ):
        processes, observer, names = graph.processes, graph.observer, graph.nodes
        number = 0
        while number < count and time.monotonic() - began < 60 * minutes:
            number += 1
            if not observer.record.running:
                began_task = begin_task(observer, graph.scenario)
                tasks, trouble = tasks + began_task, trouble + (not began_task)
            observer.until(lambda: False, rng.uniform(*PAUSE_S))
            some = rng.choice(names, size=1 + (rng.random() < 0.3), replace=False).tolist()
            durations = {name: float(np.exp(rng.uniform(*np.log(FREEZE_S)))) for name in some}
            draw = rng.random()
            if rng.random() < kills:
                killed[some[0]] += 1
                kill_and_restart(processes, observer, some[0], float(rng.uniform(*DEAD_S)))
                observer.await_nodes(names, START_S)
                observer.await_answers(START_S)
                continue
            try:
                if draw < STOPS and "planner" not in some:
                    observer.trigger("stop")
                elif draw > 1 - STOPS and "driver" not in some:
                    observer.trigger("emergency_stop")
                    faults.stopped_ns = time.time_ns()
            except GraphError as error:
                trouble += 1
                print(f"no stop: {error}", flush=True)
            faults.away = some
            freeze(processes, observer, durations)
            frozen.update(some)
            if number % 10 == 0:
                yield Outcome(
                    None, f"{number} faults, {tasks} tasks, {faults.moving} moving tables, oldest "
                    f"{faults.oldest_s:.3f} s, {len(faults.wrong)} wrong, load "
                    f"{os.getloadavg()[0]:.1f}",
                )  # fmt: skip
        observer.until(lambda: False, FREEZE_S[1])
        result = {
            "faults": number, "frozen": dict(frozen), "killed": dict(killed), "tasks": tasks,
            "minutes": (time.monotonic() - began) / 60, "tables": faults.tables,
            "moving": faults.moving, "oldest_s": faults.oldest_s, "wrong": faults.wrong,
            "trouble": trouble,
            "load": os.getloadavg()[1],
        }  # fmt: skip
        yield Outcome(result, well=not faults.wrong)
