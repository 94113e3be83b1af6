"""Tracking error against speed: the two rectangles of `follow_2`, driven at other speeds."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from harness import Result, Table
from loop import Setup, summary

from plate_core import PlateError, Rig, load_rig
from plate_core.rig import config_path
from plate_core.scenario import load_scenario
from plate_core.tasks import FollowTask
from plate_solver import RotationSolver, SinusoidSolver

SPEEDS_MM = (10, 20, 30, 40, 60, 80, 120)
"""Speeds along the paths [mm/s]; the scenario's own is 20."""

SPAN_S = 15.0
"""How long each is driven [s], but at least one lap."""

SCENARIO = "follow_2"


def measure(quick: bool) -> Result:
    """Drive the paths at several speeds, by both methods."""
    rig = load_rig()
    methods = ("sinusoids",) if quick else ("sinusoids", "rotations")
    rows = []
    with TemporaryDirectory() as folder:
        for method in methods:
            for speed in (20, 60) if quick else SPEEDS_MM:
                path = Path(folder) / f"{SCENARIO}_{speed}.yaml"
                path.write_text(at_speed(speed * 1e-3), encoding="utf-8")
                rows.append(row(rig, method, speed, summary(Setup(str(path), 0, method), rig)))
    return Result(
        [
            Table(
                "tracking",
                "2 parts, a rectangle each",
                {
                    "method": "method", "speed_mm_s": "speed [mm/s]", "rms_mm": "RMS error [mm]",
                    "max_mm": "largest [mm]", "success": "kept", "solve_ms": "solve, median [ms]",
                    "bound_mm_s": "a T / 16 [mm/s]",
                },
                rows,
                f"Paths of {SCENARIO}, corners included, images with noise; one seed. Kept: never "
                "further off than the scenario allows. a T / 16: no part can be faster on average.",
            )
        ],
        [sentence(rows, method) for method in methods],
    )  # fmt: skip


def at_speed(speed: float) -> str:
    """Return the scenario's YAML with another speed [m/s], and laps for about `SPAN_S`."""
    text = config_path(f"scenarios/{SCENARIO}.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    task = load_scenario(SCENARIO).task
    if not isinstance(task, FollowTask):
        raise PlateError(f"task of scenario {SCENARIO} is {task}, allowed: follow")
    for entry, path in zip(data["task"]["paths"], task.paths, strict=True):
        corners = np.array(path.waypoint)
        length = float(np.sum(np.linalg.norm(np.roll(corners, -1, 0) - corners, axis=1)))
        entry["speed_mps"] = speed
        entry["laps"] = max(1.0, round(speed * SPAN_S / length, 3))
    data["time_limit_s"] = 200.0
    return str(yaml.safe_dump(data))


def row(rig: Rig, method: str, speed_mm: int, run: dict[str, Any]) -> dict[str, Any]:
    """Put one run into a row."""
    solver = SinusoidSolver(rig) if method == "sinusoids" else RotationSolver(rig)
    return {
        "method": method,
        "speed_mm_s": speed_mm,
        "rms_mm": 1e3 * run["rms_error_m"],
        "max_mm": 1e3 * run["max_error_m"],
        "success": run["success"],
        "solve_ms": run["solve_ms_median"],
        "bound_mm_s": 1e3 * rig.limits.accel * solver.steering_period(2) / 16,
    }


def sentence(rows: list[dict[str, Any]], method: str) -> str:
    """Sum up one method."""
    mine = [r for r in rows if r["method"] == method]
    kept = [r["speed_mm_s"] for r in mine if r["success"]]
    errors = ", ".join(f"{r['rms_mm']:.2f} mm at {r['speed_mm_s']}" for r in mine)
    return f"{method}: RMS {errors} mm/s; kept up to {max(kept, default=0)} mm/s"
