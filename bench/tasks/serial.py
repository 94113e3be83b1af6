"""The serial path: sorting over it, accidents, and uploads."""

from __future__ import annotations

from concurrent.futures import Executor
from typing import Any

import numpy as np

from harness import Cache, Result, Table, processes, resumed
from harness.serial import Outcome, serial_run
from plate_bringup.loop import Setup, summary
from plate_core import PlateError, load_rig
from plate_core.tasks import read_scenario
from plate_core.yaml_fields import Fields
from plate_sim.device import FaultSchedule, LineFaults
from stages.upload import PERIOD_S, upload_s

SEEDS = range(10_000, 10_020)
"""Of the runs over both transports."""

RUNS = 100
"""Of each kind of accident."""

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
    uploads = [
        {
            "knots": knots,
            "bytes": 52 * (knots + 1) + 14 * -(-(knots + 1) // 4) + 36,
            "ms": 1e3 * upload_s(knots),
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
                "uploads", "A table's upload at 921,600 baud",
                {"knots": "pieces", "bytes": "bytes, about", "ms": "upload [ms]",
                 "cycle_ms": "cycle [ms]"},
                uploads,
            ),
        ],
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


def accident_run(kind: str, seed: int) -> dict[str, Any]:
    """Run the short task with one kind of accident."""
    trouble, event = KINDS[kind]
    at = 1.2 + 1.8 * float(np.random.default_rng(seed).random())
    line = FaultSchedule(LineFaults(baud=BAUD, **trouble))
    short = read_scenario(Fields(SHORT, "short", PlateError), "short")
    outcome = serial_run(Setup(short, seed), line, event, at)
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
