"""Judge a recorded run."""

from __future__ import annotations

from typing import Any

import numpy as np

from plate_core import Rig
from plate_core.graph import RunOptions
from plate_core.tasks import AssembleTask, FollowTask, PoseTask, load_scenario

from .film import check_limits, develop
from .record import Record


def judge(
    rig: Rig, options: RunOptions, record: Record, seen: list[str], exit_codes: dict[str, int]
) -> dict[str, Any]:
    """Return what goes into result.json.

    Raises
    ------
    PlateError
        If the task never began.
    """
    film = develop(record, rig)
    limits = check_limits(record, rig)
    state = record.states[-1]
    task = load_scenario(options.scenario).task
    follows = isinstance(task, FollowTask)
    follows &= float(record.last("planner", "max_error_m")) > 0
    return {
        "scenario": options.scenario,
        "method": options.method,
        "transport": options.transport,
        "seed": options.seed,
        "lockstep": options.lockstep,
        "success": state == "done" and film.dropped == 0,
        "message": state,
        "dropped": film.dropped,
        "parts": len(film.ids),
        "there": "placed" if isinstance(task, AssembleTask | PoseTask) else "sorted",
        "parts_sorted": int(record.last("planner", "parts_sorted")),
        "time_s": round(film.end, 3),
        "cycles": film.cycles,
        "rms_error_m": float(record.last("planner", "rms_error_m")) if follows else None,
        "max_error_m": float(record.last("planner", "max_error_m")) if follows else None,
        "nodes": seen,
        "exit_codes": exit_codes,
        "motor_setpoints": limits.tables,
        "setpoints_within_limits": limits.tables > 0 and not limits.faults,
        "limit_faults": list(limits.faults[:5]),
        "stroke_share_max": round(limits.stroke, 4),
        "speed_share_max": round(limits.speed, 4),
        "accel_share_max": round(limits.accel, 4),
        "missed_share": typical(record, "missed_share"),
        "solve_ms_median": typical(record, "solve_ms_median"),
        "late_cycles": int(record.last("simulator", "late cycles", "0")),
        "held_cycles": int(record.last("simulator", "held cycles", "0")),
        "gamma": round(rig.gamma, 2),
    }


def typical(record: Record, key: str) -> float | None:
    """Return the median of what the solver reported while it was at work."""
    values = [float(v[key]) for _, v in record.reports["solver"] if float(v["solve_ms_median"]) > 0]
    return round(float(np.median(values)), 4) if values else None


def summary(result: dict[str, Any]) -> str:
    """Return the result in a line or two for a reader."""
    if result["rms_error_m"] is None:
        done = f"{result['parts_sorted']} of {result['parts']} parts {result['there']}"
    else:
        whose = "part followed its path" if result["parts"] == 1 else "parts followed their paths"
        done = f"{result['parts']} {whose}, error {1e3 * result['rms_error_m']:.2f} mm rms"
    verdict = "Success" if result["success"] else f"No success ({result['message']})"
    used = max(result[f"{name}_share_max"] for name in ("stroke", "speed", "accel"))
    limits = "within limits" if result["setpoints_within_limits"] else "LIMITS BROKEN"
    return (
        f"{verdict}: {done} in {result['time_s']:.1f} s and {result['cycles']} cycles, "
        f"{result['dropped'] or 'none'} dropped; all {result['motor_setpoints']} motor tables "
        f"{limits} ({100 * used:.0f} % used)."
    )
