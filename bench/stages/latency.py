"""Latency from image to motors in the real graph.

First, each node runs in a separate process. Then all nodes run in one process. The middleware
records the publication time of each message. Therefore the speed of the measuring program has no
effect.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from harness import Result, Table

TASKS = 4
QUICK_S = 6.0
"""Length of the task in a quick run [s]."""


def measure(quick: bool) -> Result:
    """Sort ten parts in real time."""
    apart, together = measured(quick, one_process=False), measured(quick, one_process=True)
    cpu_fractions = apart[1] | {"all in one process": together[1]["one_process"]}
    tables = [
        Table.of("latency", apart[0]),
        Table.of("latency_one_process", together[0]),
        Table.of("cpu", cpu_rows(cpu_fractions)),
    ]
    return Result(tables)


def measured(quick: bool, one_process: bool) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Run the graph. Return a row for the latency of each stage, and the CPU use of the processes
    as fractions of a core."""
    from graph.series import TASK_S, run_series, stages_ms

    from plate_bringup import RunOptions

    count = 1 if quick else TASKS
    with TemporaryDirectory() as logs:
        options = RunOptions(scenario="sort_10", autostart=False, one_process=one_process)
        run = run_series(
            options,
            Path(logs),
            lambda series: len(series.tasks) >= count,
            max_s=QUICK_S if quick else TASK_S,
        )
        *_, series = run
    rows = [
        {"stage": name, "median": np.median(ms), "p99": np.percentile(ms, 99), "images": len(ms)}
        for name, ms in stages_ms(series.hops).items()
    ]
    return rows, series.cpu


def cpu_rows(fractions: dict[str, float]) -> list[dict[str, Any]]:
    """Return the CPU use of each process [% of a core]."""
    return [{"node": name, "cpu": 100 * fraction} for name, fraction in fractions.items()]
