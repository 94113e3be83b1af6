"""How fast 1 to 10 parts can be moved: bounds, global search, closed loop.

Scattered parts move along x, half of them to the left and half to the right. Their y is free. The
search looks for the periodic cycle with the maximum mean speed of the parts: many descents of the
solver within the rig's limits, from the velocities at the start of a periodic motion. Cycles either
begin and end at rest or not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from harness import Cache, Result, Table, by_case
from plate_bringup.bounds import speed_bounds
from plate_bringup.loop import Setup, run, with_settings
from plate_core import PlateCycle, Rig, load_rig
from plate_core.motion import usage
from plate_core.tasks import start_positions
from plate_solver import Goal, Limits, SinusoidSolver
from plate_solver.cycle_map import end_state
from plate_solver.sinusoids import BIN, Motions, Problem, SinusoidFamily, descend, sinusoid_basis
from tasks.runs import UNEVEN, sorting

COUNTS = (1, 2, 4, 10)
PERIODS = {0.05: 3, 0.1: 4, 0.15: 6, 0.2: 8, 0.3: 12}
"""Number of harmonics, by length of a cycle [s]: the solver's lengths, and a shorter and a longer
one."""

SCENES, STARTS, DISTURBED = 2, 60, 120
"""Number of scenes, of random start motions for each, and of disturbances of the best motion."""

SPREADS = (0.15, 0.5)
"""Sizes of disturbances, used in turn [size of the motion]."""

AHEAD_M, WEIGHT, FAR_M = 0.3, 0.04, 10.0
"""Target distance of a part [m], weight of its distance, and excess distance without cost [m]."""

COAST_S, ITERATIONS, STEP = 0.03, 24, 0.4e-3
"""Coast time [s], number of iterations and time step [s], as in the solver."""

SETTLED, FINE = 20, 1000
"""Number of cycles until the parts' velocities are periodic, and steps per cycle."""

SEEDS = range(50_000, 50_005)
"""Seeds of the closed loop's runs."""


def measure(quick: bool) -> Result:
    """Run the global search for each number of parts and each cycle length, and the closed loop for
    each number of parts."""
    rig, cache = load_rig(), Cache.of(__name__)
    counts, periods = (COUNTS[:1], (0.1,)) if quick else (COUNTS, tuple(PERIODS))
    scenes, seeds = (1, SEEDS[:1]) if quick else (SCENES, SEEDS)
    searches = {
        (count, period, rest, quick): [
            (rig, count, period, rest, scene, quick) for scene in range(scenes)
        ]
        for count in counts
        for period in periods
        for rest in (True, False)
    }
    found = by_case(fastest, searches, cache)
    driven = by_case(loop_speed, {n: [(n, seed) for seed in seeds] for n in counts}, cache)
    rows: list[dict[str, Any]] = []
    for count in counts:
        own = SinusoidSolver(rig).steering_period(count, lasting=True)
        for period in periods:
            rest, free = (
                1e3 * float(np.mean(found[count, period, r, quick])) for r in (True, False)
            )
            bounds = speed_bounds(rig, period)
            loop = 1e3 * float(np.median(driven[count]))
            rows.append(
                {
                    "parts": count, "period_s": period, "rest_mm_s": rest, "free_mm_s": free,
                    "solver": period == own, "loop_mm_s": loop if period == own else None,
                    "accel_mm_s": 1e3 * bounds.accel, "stroke_mm_s": 1e3 * bounds.stroke,
                }
            )  # fmt: skip
    facts = {"scenes": scenes, "starts": STARTS, "disturbed": DISTURBED}
    return Result([Table.of("bound", rows, first=seeds[0], last=seeds[-1], **facts)])


def fastest(
    rig: Rig, count: int, period: float, at_rest: bool, scene: int, quick: bool = False
) -> float:
    """Return the maximum mean speed that the search finds [m/s]."""
    rng = np.random.default_rng([scene, count])
    labels, position = start_positions(sorting(count), rig, rng)
    way = np.where(np.array(labels) == "black", -1.0, 1.0)
    number = PERIODS[period]
    steps = -(-max(round(period / STEP), 16 * number) // BIN) * BIN
    basis = sinusoid_basis(number, period, at_rest, steps)
    motions = Motions.of(basis, Limits.of(rig))
    family = SinusoidFamily(basis, Limits.of(rig))
    best, score, velocity = np.zeros(3 * basis.size), -np.inf, np.zeros_like(position)
    for k in range(20 if quick else STARTS + DISTURBED):
        if k < STARTS:
            start, begin = rng.standard_normal(3 * basis.size), np.zeros_like(position)
        else:
            size = SPREADS[k % 2] * np.sqrt(np.mean(best**2)) * (k % 4 > 0)
            start, begin = best + size * rng.standard_normal(best.size), velocity
        theta = start
        for most in (1.3, 1.0):
            goal = goal_towards(rig, position, begin, way)
            theta = descend(Problem.of(goal, motions, most), theta, 0.0, ITERATIONS).parameters
            cycle = kept(rig, family.cycle(theta))
            speed, begin = steady(rig, cycle, position, way)
        if speed > score:
            best, score, velocity = theta, speed, begin
    return score


def goal_towards(rig: Rig, position: np.ndarray, velocity: np.ndarray, way: np.ndarray) -> Goal:
    """Return a goal for parts at (M, 2) [m]: as far as possible along x, each in its direction
    (M,), with free y."""
    displacement = np.column_stack([way * (AHEAD_M + FAR_M), np.zeros(len(way))])
    tolerance = np.column_stack([np.full(len(way), FAR_M), np.full(len(way), 100.0)])
    return Goal(
        position, velocity, displacement, tolerance, np.full(len(way), rig.friction.accel),
        lasting=True, weight=WEIGHT, coast=COAST_S,
    )  # fmt: skip


def kept(rig: Rig, cycle: PlateCycle) -> PlateCycle:
    """Return a cycle, scaled down to the rig's limits if it exceeds them."""
    return cycle.scaled(min(1.0, 1 / max(usage(rig, cycle).overall, 1e-9)))


def steady(
    rig: Rig, cycle: PlateCycle, position: np.ndarray, way: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the mean speed of the parts [m/s] in periodic motion, and their velocities (M, 2) at
    the start of a cycle [m/s]. After each cycle, the parts are reset to their positions."""
    t = (np.arange(FINE) + 0.5) * cycle.period / FINE
    pose, twist, dt = cycle.pose(t), cycle.twist(t), np.full(FINE, cycle.period / FINE)
    friction, velocity = np.full(len(way), rig.friction.accel), np.zeros_like(position)
    speeds = []
    for _ in range(SETTLED):
        end, velocity = end_state(position, velocity, pose, twist, dt, friction)
        speeds.append(float(np.mean((end - position)[:, 0] * way)) / cycle.period)
    return float(np.mean(speeds[-4:])), velocity


def loop_speed(count: int, seed: int) -> float:
    """Return the mean speed of the parts in the closed loop, until half of their total distance to
    their sides is done [m/s]."""
    goal = 0.6 * load_rig().plate.half[0]
    first: float | None = None
    going = 1
    for moment in run(with_settings(Setup(sorting(count), seed), UNEVEN)):
        black = np.array([name.startswith("black") for name in moment.world.ids])
        left = np.maximum(goal - moment.world.position[:, 0] * np.where(black, -1, 1), 0)
        total = float(np.sum(left))
        if first is None:
            first, going = total, max(int(np.count_nonzero(left)), 1)
        if total <= first / 2:
            break
    return (first - total) / going / max(moment.time, 0.1) if first else 0.0
