"""Runs over the serial line for the tables of `measure_serial`: rows of plain values."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from harness.loop import Setup, summary
from harness.serial import Outcome, serial_run
from plate_core import load_rig
from plate_sim.device import FaultSchedule, LineFaults

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


def accident_run(kind: str, seed: int) -> dict[str, Any]:
    """Run the short task with one kind of accident."""
    trouble, event = KINDS[kind]
    at = 1.2 + 1.8 * float(np.random.default_rng(seed).random())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "short.yaml"
        path.write_text(yaml.safe_dump(SHORT), encoding="utf-8")
        line = FaultSchedule(LineFaults(baud=BAUD, **trouble))
        outcome = serial_run(Setup(str(path), seed), line, event, at)
    done = _well(outcome)
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
        "success": _well(outcome), "dropped": outcome.dropped, "time_s": outcome.time_s,
        "message": outcome.text, "kept": outcome.verdict.kept, "late": outcome.late,
        "images": outcome.images,
    }  # fmt: skip


def _well(outcome: Outcome) -> bool:
    return outcome.phase == "done" and outcome.dropped == 0
