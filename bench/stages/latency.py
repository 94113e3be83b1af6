"""Latency from image to motors in the real graph, compared with a graph that only forwards.

The nodes run in separate processes, then all in one. Both graphs run at the same time and
alternate: the image of the forwarding graph follows half a cycle after the real one. Both graphs
have messages of the same topics, types and sizes. Times are the middleware's publication times, so
the observer's speed has no effect.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from harness import Result, Table

TASKS = 4
QUICK_S = 6.0
"""Length of the single task of a quick run [s]."""


def measure(quick: bool) -> Result:
    """Sort ten parts in real time, while the forwarding graph runs."""
    apart, together = measured(quick, one_process=False), measured(quick, one_process=True)
    shares = apart[1] | {"all in one process": together[1]["one_process"]}
    tables = [
        Table.of("latency", apart[0]),
        Table.of("latency_one_process", together[0]),
        Table.of("cpu", cpu(shares)),
    ]
    return Result(tables)


def measured(quick: bool, one_process: bool) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Run both graphs. Return the rows of the stages, and the fractions of a CPU core."""
    from graph.series import TASK_S, stages_ms, work_again

    from plate_bringup import RunOptions

    most = 1 if quick else TASKS
    with TemporaryDirectory() as logs:
        options = RunOptions(scenario="sort_10", autostart=False, one_process=one_process)
        run = work_again(
            options,
            Path(logs),
            lambda series: len(series.tasks) >= most,
            beside=True,
            longest_s=QUICK_S if quick else TASK_S,
        )
        *_, series = run
    real, beside = stages_ms(series.hops()), stages_ms(series.hops("beside"))
    return [row(name, real[name], beside[name]) for name in real], series.cpu


def cpu(shares: dict[str, float]) -> list[dict[str, Any]]:
    """Return the fraction of a CPU core of each process of the real graph [%]."""
    own = {name: share for name, share in shares.items() if not name.startswith("beside_")}
    return [{"node": name, "cpu": 100 * share} for name, share in own.items()]


def row(stage: str, real: np.ndarray, beside: np.ndarray) -> dict[str, Any]:
    """Compare one stage in both graphs [ms]."""
    middle, tail = np.median(real), np.percentile(real, 99)
    other, other_tail = np.median(beside), np.percentile(beside, 99)
    return {
        "stage": stage, "median": middle, "p99": tail, "beside": other, "beside_p99": other_tail,
        "ratio": middle / other, "ratio_p99": tail / other_tail, "more": middle - other,
        "images": len(real),
    }  # fmt: skip
