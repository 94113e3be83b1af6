"""Run sorting tasks for hours in real time, and measure the growth of memory and the drift of
latency.

The parts are placed again for each task. Each task prints a line. The result contains the slopes of
each node's memory and of the latency (image stamp to motor setpoints), with 95 % confidence
intervals. A slope is computed by a least-squares line through one sample per task. All samples are
taken in the same state. The result also contains the fraction of cycles without a new motion in
time, and the ends of failed tasks.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from graph.series import Series, Task, run_series
from scipy import stats

from cases import Outcome
from plate_bringup import RunOptions

SETTLED_S = 600.0
"""Time before the first sample [s]. During this time, buffers and caches grow. If a run is shorter
than three times this value, a third of the run is used instead."""

MAX_MISSED = 1e-3
"""Maximum fraction of missed cycles."""

CONFIDENCE = 0.95


def fit_slope(time_s: np.ndarray, value: np.ndarray) -> tuple[float, float]:
    """Return the slope of the least-squares line [1/h], and the half-width of its confidence
    interval. With fewer than three samples, both values are NaN."""
    if len(time_s) < 3:
        return float("nan"), float("nan")
    line = stats.linregress(time_s / 3600, value)
    wide = stats.t.ppf((1 + CONFIDENCE) / 2, len(time_s) - 2)
    return float(line.slope), float(wide * line.stderr)


def task_line(task: Task) -> str:
    """Return a line of text about one task."""
    cycles, held, late = task.counts
    latency = 1e3 * task.latency
    memory = " ".join(f"{name} {mb:.1f}" for name, mb in task.memory_mb.items())
    return (
        f"{task.at_s:7.0f} s  {task.ended[:40]:8s} {cycles:4d} cycles, {held} held, {late} late, "
        f"latency {np.median(latency):.1f} ms, 99th percentile "
        f"{np.percentile(latency, 99):.1f} ms; "
        f"MB: {memory}; load {os.getloadavg()[0]:.1f}"
    )


def summarise(series: Series) -> dict[str, Any]:
    """Return the statistics of all tasks."""
    tasks = series.tasks
    after = min(SETTLED_S, tasks[-1].at_s / 3)
    settled = [task for task in tasks if task.at_s > after]
    times = np.array([task.at_s for task in settled])
    memory = []
    for name in tasks[0].memory_mb:
        values = np.array([task.memory_mb[name] for task in settled])
        growth, wide = fit_slope(times, values)
        memory.append(
            {
                "node": name, "first_mb": values[0], "last_mb": values[-1],
                "mb_per_hour": growth, "interval": wide, "cpu_share": series.cpu[name],
            }
        )  # fmt: skip
    cycles, held, late = np.sum([task.counts for task in tasks], axis=0).tolist()
    latency = 1e3 * np.concatenate([task.latency for task in tasks])
    drift, wide = fit_slope(times, np.array([1e3 * np.median(task.latency) for task in settled]))
    return {
        "hours": tasks[-1].at_s / 3600,
        "tasks": len(tasks), "done": sum(task.done for task in tasks),
        "ended": [task.ended for task in tasks if not task.done],
        "cycles": cycles, "held": held, "late": late, "missed_share": (held + late) / cycles,
        "tables": sum(task.tables for task in tasks), "faults": sum(task.faults for task in tasks),
        "latency_ms": np.median(latency), "latency_p99_ms": np.percentile(latency, 99),
        "latency_ms_per_hour": drift, "latency_interval": wide,
        "memory": memory,
    }  # fmt: skip


def summary_text(result: dict[str, Any]) -> str:
    """Return the statistics as text."""
    lines = [f"{'node':10s} {'MB':>15s} {'MB/h':>16s} {'CPU':>6s}"]
    for row in result["memory"]:
        lines.append(
            f"{row['node']:10s} {row['first_mb']:7.1f} {row['last_mb']:7.1f} "
            f"{row['mb_per_hour']:7.2f} +- {row['interval']:5.2f} {100 * row['cpu_share']:4.1f} %"
        )
    return "\n".join(
        [
            *lines,
            f"{result['done']} of {result['tasks']} tasks done in {result['hours']:.2f} h; "
            f"{result['faults']} of {result['tables']} motor tables broke a limit",
            f"{result['held']} cycles held and {result['late']} late of {result['cycles']}: "
            f"{100 * result['missed_share']:.3f} %",
            f"latency {result['latency_ms']:.1f} ms, 99th percentile "
            f"{result['latency_p99_ms']:.1f} ms, "
            f"drift {result['latency_ms_per_hour']:.2f} +- {result['latency_interval']:.2f} ms/h",
        ]
    )


def run(
    logs: Path, scenario: str = RunOptions.scenario, uneven: float = 0.0, minutes: float = 60.0
) -> Iterator[Outcome]:
    """Run sorting tasks repeatedly for a number of minutes. `uneven` is the spread of friction
    between parts and over the plate."""
    until = time.monotonic() + 60 * minutes
    friction = dict.fromkeys(("friction_spread", "friction_patches"), uneven)
    options = RunOptions(scenario, autostart=False)
    for now in run_series(options, logs, lambda _: time.monotonic() > until, world=friction):
        result = summarise(now)
        well = result["faults"] == 0 and result["missed_share"] <= MAX_MISSED
        yield Outcome(result, task_line(now.tasks[-1]), well, summary_text(result))
