"""1 to 6 parts on circles: tracking error against speed, and maximum speed of the loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Cache, Result, Table
from plate_bringup.loop import Setup
from plate_core import PlateError, Rig, load_rig
from plate_core.tasks import read_scenario
from plate_core.yaml_fields import Fields
from plate_solver import RotationSolver, SinusoidSolver
from tasks.runs import UNEVEN, cached_runs, summarise

SPEEDS_MM = (2, 5, 20, 40, 80, 160, 320)
"""Speeds along the circles [mm/s]. The speeds are tried in this order until one fails."""

SEEDS = (0, 1)
"""Seeds of the runs at each speed. The seeds differ in image noise, friction and the solver's
random numbers."""

CENTRES_M = ((-0.2, 0.07), (0.2, -0.07), (0.0, 0.07), (-0.2, -0.07), (0.2, 0.07), (0.0, -0.07))
"""Centres of the circles, in the order in which they are used [m]."""

COUNTS = {"sinusoids": (1, 2, 3, 4, 5, 6), "rotations": (2, 4, 6)}
"""Numbers of parts, by method."""

RADIUS_M = 0.05
"""Radius of the circles [m]."""

SPAN_S = 6.0
"""Duration of a run [s]. A run is extended to at least 0.08 laps, or shortened to at most two
laps."""

MAX_RMS_M, MAX_DELAY = 6e-3, 1.05
"""Limits for a speed that counts as reached. The first limit is the maximum RMS error of a run
[m], a hundredth of the plate's length. The second limit is the maximum ratio of the actual time to
the time at this speed. All runs must also succeed."""


def measure(quick: bool) -> Result:
    """Move 1 to 6 parts on circles, with increasing speeds."""
    rig = load_rig()
    seeds, cache = SEEDS[:1] if quick else SEEDS, Cache.of(__name__)
    going = [("sinusoids", 2)] if quick else [(name, n) for name in COUNTS for n in COUNTS[name]]
    rows: dict[tuple[str, int], list[dict[str, Any]]] = {kind: [] for kind in going}
    for speed in (20, 80) if quick else SPEEDS_MM:
        cases = {}
        for method, count in going:
            task = Fields(circles_scenario(count, 1e-3 * speed), "circles", PlateError)
            scenario = read_scenario(task, "circles")
            loops = [(Setup(scenario, seed, method), UNEVEN, rig) for seed in seeds]
            cases[method, count, speed] = loops
        for (method, count, _), runs in cached_runs(cache, cases).items():
            rows[method, count].append(row_of(rig, method, count, speed, runs))
        going = [kind for kind in going if rows[kind][-1]["kept"]]
    found = [row for method_rows in rows.values() for row in method_rows]
    facts = {"radius": 1e3 * RADIUS_M, "rms": 1e3 * MAX_RMS_M, "delay": MAX_DELAY}
    return Result([Table.of("tracking", found, seeds=SEEDS, **facts)])


def lap_count(speed: float) -> float:
    """Return the number of laps at a speed [m/s]."""
    return float(np.clip(round(speed * SPAN_S / (2 * np.pi * RADIUS_M), 3), 0.08, 2.0))


def circles_scenario(count: int, speed: float) -> dict[str, Any]:
    """Return a scenario with `count` parts, each on its own circle, at one speed [m/s]."""
    places, paths = [], []
    for k, (x, y) in enumerate(CENTRES_M[:count]):
        start = 90 * k % 360
        angle = np.radians(start)
        places.append([float(x + RADIUS_M * np.cos(angle)), float(y + RADIUS_M * np.sin(angle))])
        circle = {
            "centre_m": [x, y], "radius_m": RADIUS_M, "start_deg": start,
            "turn": "left" if k % 2 else "right",
        }  # fmt: skip
        paths.append(
            {"class": "black", "circle": circle, "speed_mps": speed, "laps": lap_count(speed)}
        )
    return {
        "description": f"{count} parts on circles at {1e3 * speed:g} mm/s.",
        "parts": [{"class": "black", "positions_m": places}],
        "task": {"kind": "follow", "max_error_m": 0.03, "paths": paths},
        "time_limit_s": 60,
    }


def row_of(
    rig: Rig, method: str, count: int, speed_mm: int, runs: list[dict[str, Any]]
) -> dict[str, Any]:
    """Return the row that summarises the runs at one speed [mm/s]."""
    solver = SinusoidSolver(rig) if method == "sinusoids" else RotationSolver(rig)
    period = solver.steering_period(count)
    speed = 1e-3 * speed_mm
    shortest_s = lap_count(speed) * 2 * np.pi * RADIUS_M / speed
    # Three periods are subtracted, because a task begins with one cycle at rest and ends with the
    # complete cycle of the last lap's end.
    delay = max((run["time_s"] - 3 * period) / shortest_s for run in runs)
    row = summarise(runs)
    kept = row["good"] == len(runs) and row["worst_rms_mm"] <= 1e3 * MAX_RMS_M
    return row | {
        "method": method, "parts": count, "speed_mm_s": speed_mm, "delay": delay,
        "kept": kept and delay <= MAX_DELAY, "bound_mm_s": 1e3 * rig.reach.accel * period / 16,
    }  # fmt: skip
