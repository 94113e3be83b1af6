"""The serial path: sorting over it, accidents, noise into both parsers, uploads and lateness."""

from __future__ import annotations

import tempfile
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from harness import Cache, Result, Table, processes, resumed
from harness.serial import Outcome, serial_run
from plate_bringup.loop import Setup, summary
from plate_core import load_rig
from plate_sim.device import FaultSchedule, LineFaults
from stages.frames import fuzz_device, fuzz_host
from stages.upload import PERIOD_S, over_terminal, upload_s

SEEDS = range(10_000, 10_020)
"""Of the runs over both transports."""

RUNS = 100
"""Of each kind of accident."""

FRAMES = 1_000_000
LATENESS_S = 600.0

BAUD = 921_600.0

SHORT = {
    "description": "Two parts go to their sides: a task of some five seconds.",
    "parts": [
        {"class": "black", "positions_m": [[-0.11, 0.06]]},
        {"class": "grey", "positions_m": [[0.11, -0.06]]},
    ],
    "task": {
        "kind": "sort", "sides": {"black": "left", "grey": "right"}, "goal_fraction": 0.6,
        "hold_s": 0.5,
    },
    "time_limit_s": 15,
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
    cache = Cache.of(__name__)
    with processes() as pool:
        paths = both_paths(pool, cache, "sort_4" if quick else "sort_10", seeds)
        work = {f"{kind} {seed}": (kind, seed) for kind in KINDS for seed in range(runs)}
        samples = resumed(pool, accident_run, work, cache)
    faults = [fault_row(kind, [row for row in samples if row["kind"] == kind]) for kind in KINDS]
    frames, seconds = (20_000, 5.0) if quick else (FRAMES, LATENESS_S)
    with processes(1) as pool:  # a fresh one: its memory is looked at
        fuzz = [
            row
            for fuzzed in (fuzz_host, fuzz_device)
            for row in resumed(pool, fuzzed, {f"{fuzzed.__name__} {frames}": (frames,)}, cache)
            if row is not None
        ]
        [late] = resumed(pool, over_terminal, {f"terminal {seconds:g} s": (seconds,)}, cache)
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
    return Result(
        [
            Table(
                "paths", f"The same tasks, seeds {seeds[0]} to {seeds[-1]}",
                {"transport": "transport", "succeeded": "succeeded", "dropped": "dropped",
                 "time_s": "time, median [s]", "longest_s": "longest [s]",
                 "late": "cycles repeated [%]"},
                paths,
                "Serial: driver's transport, line of 921,600 baud, device, in simulated time.",
            ),
            Table(
                "accidents", f"{runs} runs each of a short task over 921,600 baud",
                {"kind": "accident", "done": "went on to the end", "enables": "enables, most",
                 "told": "stopped, told why",
                 "stuck": "neither", "kept": "limits kept", "resting": "at rest in the end",
                 "time_s": "time, median [s]", "longest_s": "longest [s]",
                 "retries": "messages repeated, median", "late": "cycles repeated [%]",
                 "used": "of limits, most [%]"},
                faults,
                "An operator enables at the start, and again 1 s after a stop was told: who had an "
                "accident and two enables went on after an enable. Limits: stroke, speed and force "
                "of the motors, acceleration of motors and plate "
                "corners in all setpoints that the device commands, to 0.2 %, and no jump of more "
                "than 2 um; stroke of the plate as it glides without current. Judged apart from "
                "the device.",
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
                 "tick_p99_ms": "device's tick late by, 99 % [ms]", "tick_max_ms": "most [ms]",
                 "load": "load of the machine"},
                [late],
            ),
        ],
        [*sentences(paths, faults, fuzz), upload_sentence(uploads, late)],
        samples,
    )  # fmt: skip


def both_paths(pool: Executor, cache: Cache, scenario: str, seeds: range) -> list[dict[str, Any]]:
    """Run a scenario over both transports."""
    transports = ("sim", "serial")
    kinds = [(transport, scenario, seed) for transport in transports for seed in seeds]
    runs = resumed(pool, path_run, {str(kind): kind for kind in kinds}, cache)
    rows = []
    for transport in transports:
        own = [row for row in runs if row["transport"] == transport]
        times = [row["time_s"] for row in own]
        rows.append({
            "transport": transport,
            "succeeded": f"{sum(row['success'] for row in own)} of {len(own)}",
            "dropped": sum(row["dropped"] for row in own),
            "time_s": float(np.median(times)),
            "longest_s": max(times),
            "late": _share(own) if transport == "serial" else None,
        })  # fmt: skip
    return rows


def fault_row(kind: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Sum up the runs with one kind of accident."""
    done, told, kept, resting = (
        sum(row[key] for row in runs) for key in ("done", "told", "kept", "resting")
    )
    times = [row["time_s"] for row in runs]
    return {
        "kind": kind,
        "runs": len(runs),
        "done": done,
        "enables": max(row["enables"] for row in runs),
        "told": told,
        "stuck": len(runs) - done - told,
        "kept": kept,
        "resting": resting,
        "time_s": float(np.median(times)),
        "longest_s": max(times),
        "retries": float(np.median([row["retries"] for row in runs])),
        "late": _share(runs),
        "used": max(row["used"] for row in runs),
    }


def _share(runs: list[dict[str, Any]]) -> float:
    """Cycles that were repeated since the next was not there in time [%]."""
    return 100 * sum(row["late"] for row in runs) / max(1, sum(row["images"] for row in runs))


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


def accident_run(kind: str, seed: int) -> dict[str, Any]:
    """Run the short task with one kind of accident."""
    trouble, event = KINDS[kind]
    at = 1.2 + 1.8 * float(np.random.default_rng(seed).random())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "short.yaml"
        path.write_text(yaml.safe_dump(SHORT), encoding="utf-8")
        line = FaultSchedule(LineFaults(baud=BAUD, **trouble))
        outcome = serial_run(Setup(str(path), seed), line, event, at)
    done = well(outcome)
    told = not done and bool(outcome.troubles) and outcome.phase in ("stuck", "aborted")
    verdict = outcome.verdict
    return {
        "kind": kind, "seed": seed, "phase": outcome.phase, "text": outcome.text, "done": done,
        "told": told, "kept": verdict.kept, "resting": outcome.resting, "time_s": outcome.time_s,
        "retries": outcome.retries, "used": 100 * verdict.worst, "jump_um": 1e6 * verdict.jump,
        "travel": 100 * verdict.travel, "late": outcome.late, "images": outcome.images,
        "enables": outcome.enables,
    }  # fmt: skip


def path_run(transport: str, scenario: str, seed: int) -> dict[str, Any]:
    """Run a task over transport sim or serial, without faults."""
    setup = Setup(scenario, seed)
    row: dict[str, Any] = {"transport": transport, "scenario": scenario, "seed": seed}
    if transport == "sim":
        plain = summary(setup, load_rig())
        return row | {key: plain[key] for key in ("success", "dropped", "time_s", "message")}
    outcome = serial_run(setup, FaultSchedule(LineFaults(baud=BAUD)))
    return row | {
        "success": well(outcome), "dropped": outcome.dropped, "time_s": outcome.time_s,
        "message": outcome.text, "kept": outcome.verdict.kept, "late": outcome.late,
        "images": outcome.images,
    }  # fmt: skip


def well(outcome: Outcome) -> bool:
    return outcome.phase == "done" and outcome.dropped == 0
