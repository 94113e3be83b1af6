"""Series of tasks in the same running graph. The parts are placed again for each task.

After each task, `run_series` yields the counts of cycles, the latencies, the memory and the CPU
time up to this task.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from record.judge import check_limits

from plate_bringup import RunOptions
from plate_core import load_rig

from .gate import CHAIN
from .hops import Hops
from .observer import SETTLE_S
from .proc import cpu_s, memory_mb
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
        Whether the goal of the task was reached.
    counts : tuple of int
        Number of plate cycles, number of cycles that were repeated because no new cycle had
        arrived, and number of cycles that began late.
    tables, faults : int
        Number of motor tables, and number of violated limits.
    memory_mb : dict of str to float
        Memory of each node at the end of the task [MB].
    hops : (n, 6)
        Stamp of each image for which setpoints were published, and the publication times of the
        image and of the messages that result from it [s, UTC].
    """

    at_s: float
    ended: str
    done: bool
    counts: tuple[int, int, int]
    tables: int
    faults: int
    memory_mb: dict[str, float]
    hops: np.ndarray

    @property
    def latency(self) -> np.ndarray:
        """Time from each image's stamp to the publication of the motor setpoints (n,) [s]."""
        return np.asarray(self.hops[:, -1] - self.hops[:, 0])


@dataclass
class Series:
    """The tasks that have ended so far, and the fraction of a CPU core that each process has
    used."""

    tasks: list[Task] = field(default_factory=list)
    cpu: dict[str, float] = field(default_factory=dict)

    @property
    def hops(self) -> np.ndarray:
        """`hops` of all tasks, concatenated."""
        return np.concatenate([task.hops for task in self.tasks])


def run_series(
    options: RunOptions,
    logs: Path,
    done: Callable[[Series], bool],
    max_s: float = TASK_S,
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
        Function that receives the series up to now.
    max_s : float
        Maximum duration of a task [s].
    world : mapping, optional
        Parameters of the simulator.
    """
    with session(options, logs, pictures=False) as graph, Hops() as hops:
        graph.free()
        for name, value in (world or {}).items():
            graph.observer.set_parameter("simulator", name, value)
        names = [*graph.processes.names]
        series, began = Series(), time.monotonic()
        before = {name: cpu_s(graph.processes.pid(name)) for name in names}
        while not done(series):
            series.tasks.append(run_task(graph, hops, began, max_s))
            passed = time.monotonic() - began
            for name in names:
                used = cpu_s(graph.processes.pid(name)) - before[name]
                series.cpu[name] = used / passed
            yield series


def run_task(graph: Session, hops: Hops, began: float, max_s: float) -> Task:
    """Run one task, for at most `max_s` [s], and return its measurements."""
    observer, record = graph.observer, graph.observer.record
    names = ("cycles", "held cycles", "late cycles")
    before = [int(record.last("simulator", name, "0")) for name in names]
    observer.restart(graph.scenario)
    start = time.time()
    observer.until(lambda: record.ended, max_s)
    end = time.time()
    observer.until(lambda: False, 1.2)  # wait for the simulator's next diagnostics
    counts = [int(record.last("simulator", name, "0")) for name in names]
    state, done = record.states[-1], record.done
    # Stop the task, and wait until the plate rests. Then the record of the next task begins at
    # rest.
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
            if name != "page"
        },
        rows(hops, start, end),
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
    """Return the durations (n,) of each stage of `STAGES`, and the total durations of all stages,
    by name [ms]."""
    parts = 1e3 * np.diff(hops, axis=1)
    columns: dict[str, Any] = dict(zip(STAGES, parts.T, strict=True))
    columns["image to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 1])
    columns["stamp to setpoints"] = 1e3 * (hops[:, -1] - hops[:, 0])
    return columns
