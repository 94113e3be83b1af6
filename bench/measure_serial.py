"""The serial path: sorting over it, accidents, noise into both parsers, uploads and lateness."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from harness import Result, Table
from loop import Setup, summary
from serial_fuzz import fuzz_device, fuzz_host
from serial_line import PERIOD_S, over_terminal, upload_s
from serial_loop import Ending, serial_run
from spread import processes, spread

from plate_core import load_rig
from plate_sim.device import Accidents, Trouble

BAUD = 921_600.0
SEEDS = range(8000, 8020)
"""Of the runs over both transports."""

RUNS = 100
"""Of each kind of accident."""

FRAMES = 1_000_000
LATENESS_S = 600.0

SHORT = {
    "description": "Two parts go to their sides: a task of some ten seconds.",
    "parts": [
        {"class": "black", "positions_m": [[-0.03, 0.06]]},
        {"class": "grey", "positions_m": [[0.03, -0.06]]},
    ],
    "task": {
        "kind": "sort", "sides": {"black": "left", "grey": "right"}, "goal_fraction": 0.6,
        "hold_s": 0.5,
    },
    "time_limit_s": 60,
}  # fmt: skip

KINDS: dict[str, tuple[dict[str, float], str]] = {
    "none": ({}, ""),
    "1 % of bytes changed": ({"corrupted": 0.01}, ""),
    "1 % of bytes dropped": ({"dropped": 0.01}, ""),
    "1 % of bytes twice": ({"repeated": 0.01}, ""),
    "half of transmissions split": ({"split": 0.5}, ""),
    "delay of 20 ms each way": ({"delay": 0.02}, ""),
    "away for 2 s": ({}, "disconnect"),
    "reset": ({}, "reset"),
    "brown-out": ({}, "brown_out"),
}
"""Name of an accident: what the line does, and what happens once in mid-task."""


def measure(quick: bool) -> Result:
    """Run all; quick: a few of each."""
    seeds, runs = (SEEDS[:1], 1) if quick else (SEEDS, RUNS)
    paths = both_paths("sort_4" if quick else "sort_10", seeds)
    faults, samples = accidents(runs)
    frames = 20_000 if quick else FRAMES
    fuzz = [row for row in (fuzz_host(frames), fuzz_device(frames)) if row is not None]
    uploads = [
        {
            "knots": knots,
            "bytes": 52 * (knots + 1) + 14 * -(-(knots + 1) // 4) + 36,
            "ms": 1e3 * upload_s(knots),
            "fast_ms": 1e3 * upload_s(knots, 0.001),
            "cycle_ms": 1e3 * PERIOD_S,
        }
        for knots in (48, 64, 96)
    ]
    late = over_terminal(5.0 if quick else LATENESS_S)
    return Result(
        [
            Table(
                "paths", f"The same tasks, seeds {seeds[0]} to {seeds[-1]}",
                {"transport": "transport", "succeeded": "succeeded", "dropped": "dropped",
                 "time_s": "time, median [s]", "longest_s": "longest [s]"},
                paths,
                "Serial: driver's transport, line of 921,600 baud, device, in simulated time.",
            ),
            Table(
                "accidents", f"{runs} runs each of a short task over 921,600 baud",
                {"kind": "accident", "done": "went on to the end", "told": "stopped, told why",
                 "stuck": "neither", "kept": "limits kept", "resting": "at rest in the end",
                 "time_s": "time, median [s]", "longest_s": "longest [s]",
                 "retries": "repeated, median", "used": "of limits, most [%]"},
                faults,
                "Limits: stroke, speed and acceleration of all setpoints that the device commands, "
                "to 0.2 %, and no jump of more than 2 um; looked at apart from the device.",
            ),
            Table(
                "fuzz", "Random and mutated frames",
                {"side": "into", "frames": "frames", "crashes": "crashes",
                 "growth_kb": "memory, growth after a tenth [kB]", "setpoints": "setpoints",
                 "outside": "outside limits"},
                fuzz,
            ),
            Table(
                "uploads", "A table's upload at 921,600 baud",
                {"knots": "pieces", "bytes": "bytes, about", "ms": "looked after every 5 ms [ms]",
                 "fast_ms": "every 1 ms [ms]", "cycle_ms": "cycle [ms]"},
                uploads,
            ),
            Table(
                "terminal", "A new table of 64 pieces each 200 ms over a pseudo-terminal",
                {"cycles": "cycles", "upload_ms": "upload, median [ms]",
                 "upload_p99_ms": "99 % [ms]", "late_share": "share too late",
                 "tick_p99_ms": "device's tick late by, 99 % [ms]", "tick_max_ms": "most [ms]"},
                [late],
            ),
        ],
        [*sentences(paths, faults, fuzz), upload_sentence(uploads, late)],
        samples,
    )  # fmt: skip


def both_paths(scenario: str, seeds: range) -> list[dict[str, Any]]:
    """Run a scenario over both transports."""
    rig = load_rig()
    with processes(os.cpu_count() or 1) as pool:
        plain = list(spread(pool, summary, [(Setup(scenario, s), rig) for s in seeds], _silent))
        line = Accidents(Trouble(baud=BAUD))
        serial = list(
            spread(pool, serial_run, [(Setup(scenario, s), line) for s in seeds], _silent)
        )
    rows = [
        {"transport": "sim", "succeeded": sum(r["success"] for r in plain),
         "dropped": sum(r["dropped"] for r in plain), "times": [r["time_s"] for r in plain]},
        {"transport": "serial", "succeeded": sum(_well(e) for e in serial),
         "dropped": sum(e.dropped for e in serial), "times": [e.time_s for e in serial]},
    ]  # fmt: skip
    for row in rows:
        times = row.pop("times")
        row |= {"time_s": float(np.median(times)), "longest_s": max(times)}
        row["succeeded"] = f"{row['succeeded']} of {len(seeds)}"
    return rows


def accidents(runs: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Run the short task with each kind of accident."""
    with tempfile.TemporaryDirectory() as folder, processes(os.cpu_count() or 1) as pool:
        path = Path(folder) / "short.yaml"
        path.write_text(yaml.safe_dump(SHORT), encoding="utf-8")
        work = []
        for trouble, event in KINDS.values():
            line = Accidents(Trouble(baud=BAUD, **trouble))
            for seed in range(runs):
                at = 2 + 3 * float(np.random.default_rng(seed).random())
                work.append((Setup(str(path), seed), line, event, at))
        endings = list(spread(pool, serial_run, work, _silent))
    rows = [fault_row(kind, endings[i * runs : (i + 1) * runs]) for i, kind in enumerate(KINDS)]
    samples = [
        {"kind": kind, "seed": seed, "phase": e.phase, "text": e.text, "time_s": e.time_s}
        for i, kind in enumerate(KINDS)
        for seed, e in enumerate(endings[i * runs : (i + 1) * runs])
    ]
    return rows, samples


def fault_row(kind: str, endings: list[Ending]) -> dict[str, Any]:
    """Sum up the runs with one kind of accident."""
    done = [e for e in endings if _well(e)]
    told = [e for e in endings if not _well(e) and e.troubles and e.phase in ("stuck", "aborted")]
    times = [e.time_s for e in endings]
    watches = [e.watch for e in endings]
    return {
        "kind": kind,
        "runs": len(endings),
        "done": len(done),
        "told": len(told),
        "stuck": len(endings) - len(done) - len(told),
        "kept": sum(w.kept for w in watches),
        "resting": sum(e.resting for e in endings),
        "time_s": float(np.median(times)),
        "longest_s": max(times),
        "retries": float(np.median([e.retries for e in endings])),
        "used": 100 * max(max(w.stroke, w.speed, w.accel) for w in watches),
    }


def _well(ending: Ending) -> bool:
    return ending.phase == "done" and ending.dropped == 0


def _silent(text: str) -> None:
    """Progress is not told."""


def sentences(
    paths: list[dict[str, Any]], faults: list[dict[str, Any]], fuzz: list[dict[str, Any]]
) -> list[str]:
    """Sum up tasks, accidents and fuzz."""
    told = [f"{row['transport']}: {row['succeeded']} sorted" for row in paths]
    runs = sum(row["runs"] for row in faults)
    ended = sum(row["done"] + row["told"] for row in faults)
    kept, resting = (sum(row[key] for row in faults) for key in ("kept", "resting"))
    return [
        ", ".join(told),
        f"{ended} of {runs} runs with accidents went on or stopped with a reason, {kept} within "
        f"all limits, {resting} at rest in the end",
        *(
            f"{row['frames']} frames into the {row['side']}: {row['crashes']} crashes, memory "
            f"+{row['growth_kb']} kB, {row['outside']} setpoints outside limits"
            for row in fuzz
        ),
    ]


def upload_sentence(uploads: list[dict[str, Any]], late: dict[str, Any]) -> str:
    """Sum up uploads and lateness."""
    return (
        f"upload of {uploads[1]['knots']} pieces: {uploads[1]['ms']:.0f} ms of a cycle of "
        f"{uploads[1]['cycle_ms']:.0f} ms at 921,600 baud; {late['upload_ms']:.0f} ms over a "
        f"pseudo-terminal, 99 % within {late['upload_p99_ms']:.0f} ms, "
        f"{100 * late['late_share']:.1f} % too late"
    )
