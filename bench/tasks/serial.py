"""The serial path: a short task with faults of the line and the device."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from harness.serial import serial_run
from plate_bringup.loop import Setup
from plate_core import PlateError
from plate_core.tasks import read_scenario
from plate_core.yaml_fields import Fields
from plate_sim.device import FaultSchedule, LineFaults

RUNS = 100
"""Number of runs of each kind of accident."""

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
"""Kinds of accidents by name: permanent faults of the line, and a single event during the task."""


def measure(quick: bool) -> Result:
    """Run all accidents. A quick measurement has only a few runs of each kind of accident."""
    runs = 1 if quick else RUNS
    work = {kind: [(kind, seed) for seed in range(runs)] for kind in KINDS}
    faults = [
        fault_row(*found) for found in by_case(accident_run, work, Cache.of(__name__)).items()
    ]
    return Result([Table.of("accidents", faults, runs=runs)])


def fault_row(kind: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the row that summarises the runs with one kind of accident."""
    sums = {key: sum(row[key] for row in runs) for key in ("done", "stopped", "kept", "resting")}
    maxima = {key: max(row[key] for row in runs) for key in ("enables", "used")}
    return {"kind": kind, **sums, **maxima, "stuck": len(runs) - sums["done"] - sums["stopped"]}


def accident_run(kind: str, seed: int) -> dict[str, Any]:
    """Run the short task with one kind of accident."""
    trouble, event = KINDS[kind]
    fault_s = 1.2 + 1.8 * float(np.random.default_rng(seed).random())
    faults = FaultSchedule(LineFaults(baud=BAUD, **trouble))
    short = read_scenario(Fields(SHORT, "short", PlateError), "short")
    last, line = serial_run(Setup(short, seed), faults, event, fault_s)
    phase, verdict = last.progress.phase, line.plate_check.verdict()
    done = phase == "done" and last.world.dropped == 0
    return {
        "done": done, "stopped": not done and bool(line.troubles) and phase in ("stuck", "aborted"),
        "kept": verdict.kept, "used": 100 * verdict.worst, "resting": line.resting,
        "enables": line.operator.enables,
    }  # fmt: skip
