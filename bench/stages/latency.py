"""From image to motors in the real graph, beside a graph of as many processes that only forwards.

Both run at the same time and take turns: the forwarders' image comes half a cycle after the real
one. Their messages have the real ones' topics, types and sizes. Times are those at which the
middleware published a message; the observer's own pace does not count.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from harness import ROOT, Result, Table

sys.path.append(str(ROOT / "tools"))

TASKS = 4
QUICK_S = 6.0
"""Length of the only task of a quick run [s]."""


def measure(quick: bool) -> Result:
    """Sort ten parts in real time, beside the forwarders."""
    from graph.forward import NAMESPACE
    from graph.series import STAGES, stages_ms, work_again

    from plate_bringup import RunOptions

    most = 1 if quick else TASKS
    with TemporaryDirectory() as logs:
        options = RunOptions(scenario="sort_10", autostart=False)
        run = work_again(
            options,
            Path(logs),
            lambda series: len(series.tasks) >= most,
            beside=True,
            **({"longest_s": QUICK_S} if quick else {}),
        )
        *_, series = run
    real, beside = stages_ms(series.hops()), stages_ms(series.hops("beside"))
    rows = [row(name, real[name], beside[name]) for name in real]
    whole = rows[-2]
    computed = sum(r["more"] for r in rows if r["stage"] in STAGES[1:])
    shares = ", ".join(
        f"{r['stage']} {100 * r['more'] / computed:.0f} %" for r in rows if r["stage"] in STAGES[1:]
    )
    cpu: list[dict[str, Any]] = [
        {"node": name, "cpu": 100 * share, "beside": 100 * series.cpu[f"{NAMESPACE}_{name}"]}
        for name, share in series.cpu.items()
        if not name.startswith(NAMESPACE)
    ]
    return Result(
        [
            Table(
                "latency", "Ten parts: when messages are published, after those they answer",
                {
                    "stage": "stage", "median": "median [ms]", "p99": "99 % [ms]",
                    "beside": "forwarding: median [ms]", "beside_p99": "99 % [ms]",
                    "ratio": "ratio of medians", "ratio_p99": "of 99 %",
                    "more": "median more [ms]", "images": "images",
                },
                rows,
                "camera: from stamp to published image; here it includes the simulation's picture.",
            ),
            Table(
                "cpu", "Share of one core [%]",
                {"node": "node", "cpu": "real", "beside": "forwarding"},
                cpu,
            ),
        ],
        [
            f"image to setpoints {whole['median']:.1f} ms, forwarding {whole['beside']:.1f} ms: "
            f"{whole['ratio']:.2f} times; 99 %: {whole['ratio_p99']:.2f} times",
            f"{computed:.1f} ms more than forwarding: {shares}",
            f"{sum(r['cpu'] for r in cpu):.0f} % of a core for all nodes, forwarding "
            f"{sum(r['beside'] for r in cpu):.0f} %",
        ],
    )  # fmt: skip


def row(stage: str, real: np.ndarray, beside: np.ndarray) -> dict[str, Any]:
    """Compare one stage in both graphs [ms]."""
    middle, tail = np.median(real), np.percentile(real, 99)
    other, other_tail = np.median(beside), np.percentile(beside, 99)
    return {
        "stage": stage, "median": middle, "p99": tail, "beside": other, "beside_p99": other_tail,
        "ratio": middle / other, "ratio_p99": tail / other_tail, "more": middle - other,
        "images": len(real),
    }  # fmt: skip
