"""Series of tasks in the same running graph. The parts are put down again for each task.

After each task, `work_again` yields counts of cycles, latencies, memory and CPU time so far. For
comparison it can run a second graph that only forwards messages of the same sizes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from record.judge import check_limits

from plate_bringup import RunOptions
from plate_core import load_rig

from .hops import Hops
from .observer import SETTLE_S
from .proc import cpu_s, memory_mb
from .relays import CHAIN, NAMESPACE, NODES, command
from .session import Session, session

TASK_S = 240.0
"""Maximum wait for the end of a task [s]."""

STAGES = ("camera", "detector", "planner", "solver", "driver")
"""Stages that publish the messages of `CHAIN`, in the same order."""


@dataclass(frozen=True)
class Task:
    """One task of a series.

    Attributes
    ----------
    at_s : float
        Time from the start of the series to the end of the task [s].
    ended : str
        Text of the final task status.
    done : bool
        Whether its goal was reached.
    counts : tuple of int
        Number of plate cycles, of cycles repeated because no new one had arrived, and of cycles
        that began late.
    tables, faults : int
        Number of motor tables, and number of violated limits.
    memory_mb : dict of str to float
        Memory of each node at the end of the task [MB].
    hops, beside : (n, 6) arrays
        Stamp of each answered image, and the publication times of the image and of its answers [s,
        UTC], in the real graph and in the one that only forwards.
    """

    at_s: float
    ended: str
    done: bool
    counts: tuple[int, int, int]
    tables: int
    faults: int
    memory_mb: dict[str, float]
    hops: np.ndarray
    beside: np.ndarray

    @property
    def latency(self) -> np.ndarray:
        """Time from each image's stamp to the publication of the motor setpoints (n,) [s]."""
        return np.asarray(self.hops[:, -1] - self.hops[:, 0])


@dataclass
class Series:
    """Tasks so far, and the fraction of a CPU core that each process has used."""

    tasks: list[Task] = field(default_factory=list)
    cpu: dict[str, float] = field(default_factory=dict)

    def hops(self, kind: str = "hops") -> np.ndarray:
        """Return `hops` or `beside` of all tasks, concatenated."""
        return np.concatenate([getattr(task, kind) for task in self.tasks])


def work_again(
    options: RunOptions,
    logs: Path,
    done: Callable[[Series], bool],
    beside: bool = False,
    longest_s: float = TASK_S,
    world: Mapping[str, float] | None = None,
) -> Iterator[Series]:
    """Run tasks in real time until `done` returns True. Yield the series after each task.

    Parameters
    ----------
    options : RunOptions
        Options without lockstep.
    logs : path
        Folder for the nodes' logs.
    done : callable
        Receives the series so far.
    beside : bool
        Whether a graph that only forwards runs at the same time.
    longest_s : float
        Maximum duration of a task [s].
    world : mapping, optional
        Parameters of the simulator.
    """
    with ExitStack() as stack:
        graph = stack.enter_context(session(options, logs, pictures=False))
        hops = stack.enter_context(Hops())
        graph.free()
        for name, value in (world or {}).items():
            graph.observer.set_parameter("simulator", name, value)
        names, others = [*graph.processes.names], None
        if beside:
            # A short task provides messages of realistic size for the graph that forwards.
            one_task(graph, hops, None, 0.0, min(longest_s, 5.0))
            others = stack.enter_context(Hops(NAMESPACE))
            names += forward(graph, hops, others, logs)
        series, began = Series(), time.monotonic()
        before = {name: cpu_s(graph.processes.pid(name)) for name in names}
        while not done(series):
            series.tasks.append(one_task(graph, hops, others, began, longest_s))
            passed = time.monotonic() - began
            for name in names:
                used = cpu_s(graph.processes.pid(name)) - before[name]
                series.cpu[name] = used / passed
            yield series


def forward(graph: Session, hops: Hops, others: Hops, logs: Path) -> list[str]:
    """Start the graph that only forwards. When all its messages arrive, return the names of its
    processes."""
    for topic, _ in CHAIN:
        (logs / topic).write_bytes(hops.newest[topic])
    commands = {f"{NAMESPACE}_{name}": command(name, str(logs)) for name in NODES}
    graph.processes.add(commands)
    graph.observer.until(lambda: any(map(all, [*others.times.values()])), TASK_S)
    return list(commands)


def one_task(
    graph: Session, hops: Hops, others: Hops | None, began: float, longest_s: float
) -> Task:
    """Run one task, for at most `longest_s` [s], and return its measurements."""
    observer, record = graph.observer, graph.observer.record
    names = ("cycles", "held cycles", "late cycles")
    before = [int(record.last("simulator", name, "0")) for name in names]
    observer.begin_anew(graph.scenario)
    start = time.time()
    observer.until(lambda: record.ended, longest_s)
    end = time.time()
    observer.until(lambda: False, 1.2)  # wait for the simulator's next diagnostics
    counts = [int(record.last("simulator", name, "0")) for name in names]
    state, done = record.states[-1], record.done
    # The plate must rest before the record is cleared, so that the next record begins at rest.
    observer.trigger("stop")
    observer.until(lambda: False, SETTLE_S)
    limits = check_limits(record, load_rig(graph.options.rig_file))
    task = Task(
        time.monotonic() - began,
        state,
        done,
        (counts[0] - before[0], counts[1] - before[1], counts[2] - before[2]),
        limits.tables,
        len(limits.faults),
        {
            name: memory_mb(graph.processes.pid(name))
            for name in graph.processes.names
            if not name.startswith(("beside_", "page"))
        },
        rows(hops, start, end),
        rows(others, start, end) if others is not None else np.zeros((0, len(CHAIN) + 1)),
    )
    record.tables.clear()
    record.starts.clear()
    record.truth.clear()
    for messages in record.diagnostics.values():
        del messages[:-1]
    return task


def rows(hops: Hops, start: float, end: float) -> np.ndarray:
    """Return stamps and publication times (n, 6) [s] of the answered images with stamps between
    `start` and `end`."""
    times = sorted((stamp, *row) for stamp, row in list(hops.times.items()) if all(row))
    hops.times.clear()
    found = 1e-9 * np.array(times, dtype=float).reshape(-1, len(CHAIN) + 1)
    inside = (found[:, 0] > start) & (found[:, 0] < end)
    return np.asarray(found[inside])


def stages_ms(hops: np.ndarray) -> dict[str, np.ndarray]:
    """Return the duration of each stage of `STAGES`, and of all stages, by name (n,) [ms]."""
    parts = 1e3 * np.diff(hops, axis=1)
    columns: dict[str, Any] = dict(zip(STAGES, parts.T, strict=True))
    columns["image to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 1])
    columns["stamp to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 0])
    return columns
