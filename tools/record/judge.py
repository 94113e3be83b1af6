"""Evaluation of a recorded run: checks all motor tables against the rig's limits, and summarises
the result of the task for result.json and for the terminal."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from graph.observer import Record
from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from plate_bringup import RunOptions
from plate_core import PlateCycle, PlateError, Rig
from plate_core.motion import is_rest
from plate_core.ros import msg_to_cycle, msg_to_motors, nanoseconds
from plate_core.tasks import AssembleTask, FollowTask, PoseTask, Task, load_scenario
from plate_planner.tasks import SLOWED

from .film import decode_record
from .limits import limit_fractions, thermal_load

WAITS = {"held_cycles": "cycles held because no answer came", "late_cycles": "late cycles"}
"""Texts about the effects of a computer that was too slow, by key of the result."""

BUS = {"stroke": 1.002, "speed": 1.002, "acceleration": 1.1}
"""Maximum values of the firmware's commands to drives on a bus, as fractions of the limits. The
fractions exceed 1 because the motors' splines differ from the plate's motion. Braking also adds a
tenth to the acceleration."""

LIMITS = ("stroke", "speed", "accel", "force")
"""Names of the values of `limit_fractions`."""

EARLIER = 4
"""Number of earlier tables that are compared. A table that begins in motion must continue one of
these tables. If a table arrives too late, the device does not execute it. The next table then
continues an earlier table."""

ROUNDING = 1e-6
"""Maximum error by rounding, as a fraction of a limit."""

GAP_S = 5e-3
"""Maximum time between the end of a cycle and the start of the next one [s]. After a longer time
between two cycles, the report of a cycle was lost, or the simulator was late."""


@dataclass(frozen=True)
class LimitCheck:
    """Result of the check of all motor tables against the rig's limits.

    Attributes
    ----------
    tables : int
        Number of motor tables.
    faults : tuple of str
        Messages about invalid tables, and about cycles that began with a jump of the plate. Empty
        if there are no such faults.
    fractions : dict of str to float
        Maximum fraction of each limit, by `LIMITS`. `heat` is the maximum of a motor's I2t load
        over all tables, as a fraction of the continuous load.
    """

    tables: int
    faults: tuple[str, ...]
    fractions: dict[str, float]


def check_limits(record: Record, rig: Rig) -> LimitCheck:
    """Check every motor table, with equations of motion that are independent of the solver and the
    driver.

    The heat h of a motor follows h' = p + (h - p) exp(-T / thermal_time_s) for a table of length T
    with the load p of `thermal_load`.
    """
    faults: list[str] = []
    maxima, heat, hottest = np.zeros(4), np.zeros(len(rig.motors)), 0.0
    before: deque[PlateCycle] = deque(maxlen=EARLIER)
    for number, data in enumerate(record.tables):
        try:
            cycle = msg_to_motors(rig, deserialize_message(data, JointTrajectory))
        except PlateError as error:
            faults.append(f"motor table {number}: {error}")
            continue
        fractions = np.max([limit_fractions(rig, part) for part in cycle.parts], axis=0)
        load = thermal_load(rig, cycle)
        heat = load + (heat - load) * np.exp(-cycle.period / rig.limits.thermal_time_s)
        hottest = max(hottest, float(np.max(heat)))
        maxima = np.maximum(maxima, fractions)
        if np.any(fractions > 1 + ROUNDING):
            faults.append(
                f"motor table {number}: stroke {fractions[0]:.4f}, speed {fractions[1]:.4f}, "
                f"acceleration {fractions[2]:.4f}, force {fractions[3]:.4f} of the limit"
            )
        if hottest > 1 + ROUNDING:
            faults.append(f"motor table {number}: heat {hottest:.4f} of the limit")
        if not (cycle.starts_at_rest or any(map(cycle.follows, before))):
            faults.append(f"motor table {number}: begins neither at rest nor in the end of another")
        if not is_rest(cycle.parts[-1].state(-1)):
            faults.append(f"motor table {number}: does not end at rest at home")
        before.append(cycle)
    faults += find_jumps(record.starts)
    result = {**dict(zip(LIMITS, maxima.tolist(), strict=True)), "heat": hottest}
    return LimitCheck(len(record.tables), tuple(faults), result)


def find_jumps(starts: Iterable[bytes]) -> list[str]:
    """Return messages about jumps of the plate between two executed cycles.

    A motor table is valid if it continues any of the last tables. But the plate must execute this
    table only after the table that it continues. Therefore this check uses the reported starts of
    cycles.

    Parameters
    ----------
    starts : iterable of bytes
        Messages of cycle_started.
    """
    faults: list[str] = []
    before: PlateCycle | None = None
    end_ns = began_ns = 0
    for data in starts:
        msg = deserialize_message(data, JointTrajectory)
        began = nanoseconds(msg.header.stamp)
        # in lockstep, the start of a cycle can be published twice
        if before is not None and began == began_ns:
            continue
        try:
            cycle = msg_to_cycle(msg)
        except PlateError as error:
            faults.append(f"cycle started at {1e-9 * began:.3f} s: {error}")
            before = None
            continue
        in_turn = before is not None and abs(began - end_ns) <= 1e9 * GAP_S
        if before is not None and in_turn and not cycle.follows(before):
            gap = np.max(np.abs(cycle.state(0) - before.state(-1)), axis=1)
            faults.append(
                f"cycle started at {1e-9 * began:.3f} s: the plate jumps by {gap[0]:.3g} m or rad, "
                f"{gap[1]:.3g} m/s or rad/s, {gap[2]:.3g} m/s2 or rad/s2"
            )
        before, began_ns, end_ns = cycle, began, began + round(1e9 * cycle.period)
    return faults


def evaluate(
    rig: Rig, options: RunOptions, record: Record, seen: list[str], exit_codes: dict[str, int]
) -> dict[str, Any]:
    """Return the content of result.json.

    Raises
    ------
    PlateError
        If no task was started.
    """
    film = decode_record(record, rig)
    limits = check_limits(record, rig)
    task = load_scenario(options.scenario).task
    follows = isinstance(task, FollowTask)
    poses = isinstance(task, PoseTask)
    follows &= float(record.last("planner", "max_error_m")) > 0
    bus = {
        name: float(record.last("device", f"commanded {name} of the drives", "nan")) for name in BUS
    }
    kept = limits.tables > 0 and not limits.faults
    if options.firmware:
        kept &= all(bus[name] <= max_ms for name, max_ms in BUS.items())
    drive = rig.motors[0].drive
    return {
        "scenario": options.scenario,
        "method": options.method,
        "transport": drive.kind if drive and options.firmware else options.transport,
        "seed": options.seed,
        "lockstep": options.lockstep,
        "success": record.done and film.dropped == 0,
        "message": record.states[-1],
        "dropped": film.dropped,
        "simulated": film.simulated,
        "parts": film.parts,
        "there": placed_word(task),
        "parts_sorted": int(record.last("planner", "parts_sorted")),
        "time_s": round(film.end, 3),
        "cycles": film.cycles,
        "rms_error_m": float(record.last("planner", "rms_error_m")) if follows else None,
        "max_error_m": float(record.last("planner", "max_error_m")) if follows else None,
        "nodes": seen,
        "exit_codes": exit_codes,
        "motor_setpoints": limits.tables,
        "setpoints_within_limits": kept,
        "bus_shares_max": bus if options.firmware else None,
        "limit_faults": list(limits.faults[:5]),
        **{f"{name}_share_max": round(fraction, 4) for name, fraction in limits.fractions.items()},
        "missed_share": median_value(record, "missed_fraction"),
        "solve_ms_median": median_value(record, "solve_ms_median"),
        "turn_error_deg": float(record.last("planner", "turn_error_deg")) if poses else None,
        "pace": float(record.last("planner", "pace")) if follows else None,
        "late_cycles": int(record.last("simulator", "late cycles", "0")),
        "held_cycles": int(record.last("simulator", "held cycles", "0")),
        "load": round(os.getloadavg()[0], 2),
        "gamma": round(rig.gamma, 2),
    }


def placed_word(task: Task) -> str:
    """Return the word for parts at their targets: "placed" or "sorted"."""
    return "placed" if isinstance(task, AssembleTask | PoseTask) else "sorted"


def median_value(record: Record, key: str) -> float | None:
    """Return the median of a value in the solver's diagnostics during its searches, or None if the
    solver made no search."""
    reports = [report.values for report in record.reports("solver")]
    values = [float(v[key]) for v in reports if float(v["solve_ms_median"]) > 0]
    return round(float(np.median(values)), 4) if values else None


def summary(result: dict[str, Any]) -> str:
    """Return the result as a sentence for the terminal."""
    done, end = _feeding_row(result) if "picks" in result else _motion_row(result)
    verdict = "Success" if result["success"] else f"No success ({result['message'] or 'see below'})"
    limits = "within limits" if result["setpoints_within_limits"] else "LIMITS BROKEN"
    return f"{verdict}: {done}; all {result['motor_setpoints']} motor tables {limits}{end}"


def _motion_row(result: dict[str, Any]) -> tuple[str, str]:
    if result["rms_error_m"] is None:
        done = f"{result['parts_sorted']} of {result['parts']} parts {result['there']}"
    else:
        whose = "part followed its path" if result["parts"] == 1 else "parts followed their paths"
        done = f"{result['parts']} {whose}, error {1e3 * result['rms_error_m']:.2f} mm rms"
        if result["pace"] < SLOWED:
            done += f", at {100 * result['pace']:.0f} % of the requested speed"
    if result["turn_error_deg"] is not None:
        done += f", maximum angle error {result['turn_error_deg']:.1f} degrees"
    done += f" in {result['time_s']:.1f} s and {result['cycles']} cycles"
    used = max(result[f"{name}_share_max"] for name in LIMITS)
    waits = [f"{result[key]} {text}" for key, text in WAITS.items() if result[key]]
    waited = f" {', '.join(waits)} (machine load {result['load']:g})." if waits else ""
    lost = f"{result['dropped'] or 'none'} dropped"
    if not result["simulated"]:
        lost = f"{result['parts'] - result['dropped']} detected at the end"
    return f"{done}, {lost}", f" ({100 * used:.0f} % used).{waited}"


def _feeding_row(result: dict[str, Any]) -> tuple[str, str]:
    done = f"{result['picks']} parts taken in {result['time_s']:.0f} s"
    if result["picks"]:
        (median_mm, max_mm), (turned, max_deg) = result["pick_error_mm"], result["pick_error_deg"]
        done += (
            f" ({result['parts_per_minute']:.0f} per minute), the robot waited "
            f"{100 * result['robot_waits_share']:.1f} % of the time. The parts' errors were "
            f"{median_mm:.2f} mm and {turned:.1f} degrees, at most {max_mm:.2f} mm and "
            f"{max_deg:.1f} degrees"
        )
    return (
        f"{done}; {result['picks_failed']} picks failed, {result['discharged']} parts went to the "
        f"chute, {result['dropped'] or 'none'} lost",
        ".",
    )
