"""Method A: what forces rotations can guarantee, at what cost, and what comes of them in motion.

Parts lie at random, at least 10 % of the plate's width apart. A request asks for a force of size r
in a random direction of each part; guaranteed is the greatest r that takes one cycle of time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import linprog

from harness import Result, Table, cpu_time, race
from plate_core import PlateCycle, Rig, load_rig
from plate_core.motion import usage
from plate_sim import simulate
from plate_solver import Goal, RotationSolver, average_force
from plate_solver.maps import finely_sampled
from plate_solver.rotations import (
    Library,
    grid,
    least_time,
    plan_rotations,
    ring,
    solve_weights,
    with_return_strokes,
)

PARTS = 10
APART = 0.1
"""Least distance of parts, in widths of the plate."""

WORST_STARTS = 8
"""Starts of the search for the worst directions."""

GAIN = 30.0
"""Bound on inverse singular values, as in section 3.1.5."""

REALISED = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3)
"""Shares of the guaranteed force that are tried as motions."""

RESTARTS = 12
"""Further starts on the cycle map where parts are few: each is cheap."""

DRIFTS = (0.0025, 0.005, 0.010)
"""Sizes of requests on the cycle map [m/s]. The sorter asks 0.012 to 0.024 along x and leaves
0.007 of slack along y; here every part is asked a direction of its own, with no slack."""


def measure(quick: bool) -> Result:
    """Measure forces, times, closures, orders and displacements."""
    rig = load_rig()
    count = 6 if quick else 40
    forces = force_rows(rig, count)
    times = time_rows(rig, 0.2 if quick else 3.0)
    realised = realised_rows(rig, 4 if quick else count)
    orders = order_rows(rig, 4 if quick else 30)
    moved = moved_rows(rig, 3 if quick else 12)
    tables = [
        Table(
            "guaranteed",
            f"Guaranteed force at {PARTS} random parts [mu m g], {count} trials",
            {
                "centres": "centres", "method": "method", "number": "N", "p10": "10 %",
                "median": "median", "worst_p10": "worst direction, 10 %",
            },
            forces,
            "Before realisation: turning takes no time. Worst direction: found by search from "
            f"{WORST_STARTS} starts. The paper's way: 24 centres, SVD.",
        ),
        Table(
            "times",
            f"Time of the linear problem, {PARTS} parts",
            {"method": "method", "milliseconds": "time [ms]", "times_ours": "times ours"},
            times,
        ),
        Table(
            "realised",
            f"Closed motions of 0.2 s within the limits, Gamma = {rig.gamma:.1f}, {PARTS} parts",
            {
                "closure": "closure", "p10": "realised, 10 % [mu m g]", "median": "median",
                "limit": "of limits", "milliseconds": "solve, median [ms]",
                "p99": "99 % [ms]", "plan": "of it the plan [ms]",
            },
            realised,
            "Realised: the largest of 8 shares of the guaranteed force that `solve` meets to 1e-3, "
            "by the exact average of its motion. Times: of a cold solve for half of it.",
        ),
        Table(
            "orders",
            f"Order of rotations on the cycle map: missed share, {PARTS} parts, 5 mm/s",
            {
                "order": "order", "before": "before correction [%]", "after": "after [%]",
                "milliseconds": "time [ms]",
            },
            orders,
        ),
        Table(
            "moved",
            "Displacement over one cycle in the exact simulator, from a cold start",
            {
                "parts": "parts M", "drift": "request [mm/s]", "median": "missed, median [%]",
                "p90": "90 % [%]", "milliseconds": "time, median [ms]", "p99": "99 % [ms]",
            },
            moved,
            "Missed: root mean square over parts and axes of asked minus simulated, over asked.",
        ),
    ]  # fmt: skip
    return Result(tables, summary(forces, times, realised, moved))


def time_rows(rig: Rig, seconds: float) -> list[dict[str, Any]]:
    """Race the linear programme, warm and cold, beside HiGHS, least squares and the SVD."""
    library = Library.around(rig.plate.half)
    position, direction = request(rig, PARTS, 0)
    moved = position + 1e-3 * np.random.default_rng(0).normal(size=position.shape)
    matrix, wanted = library.forces(moved), direction.T.ravel()
    ones, dear = np.ones(matrix.shape[1]), np.full(len(matrix), 1e3)
    basis = least_time(library.forces(position), wanted, ones, dear, dear).basis
    both = np.hstack([matrix, -matrix])
    few = Library.about(grid(rig.plate.half), rig.plate.half).forces(moved)
    cold, highs = "ours, cold", "scipy linprog (HiGHS)"
    timed = race(
        {
            cold: lambda: least_time(matrix, wanted, ones, dear, dear),
            "ours, last basis": lambda: least_time(matrix, wanted, ones, dear, dear, basis),
            highs: lambda: linprog(np.ones(both.shape[1]), A_eq=both, b_eq=wanted, method="highs"),
            "numpy lstsq, library": lambda: np.linalg.lstsq(matrix, wanted, rcond=None),
            "SVD, 24 centres": lambda: solve_weights(few, wanted, GAIN),
        },
        seconds,
    )
    ours = least_time(matrix, wanted, ones, dear, dear).cost
    peer = linprog(np.ones(both.shape[1]), A_eq=both, b_eq=wanted, method="highs").fun
    if abs(ours - peer) > 1e-6 * peer:
        raise RuntimeError(f"least times differ: {ours} and {peer} by HiGHS")
    return [
        {
            "method": name,
            "milliseconds": 1e3 * timed.median(name),
            "times_ours": timed.lead(cold, name),
        }
        for name in timed.times
    ]


def realised_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Put guaranteed forces into closed motions, by both ways of closing them."""
    rows = []
    for closure in ("sequence", "strokes"):
        solver = RotationSolver(rig, closure=closure, restarts=1)
        found, solve_s, plan_s, limits = [], [], [], []
        for seed in range(-1, count):
            position, direction = request(rig, PARTS, max(seed, 0))
            began = cpu_time()
            plan = plan_rotations(solver.library, position, direction)
            plan_s.append(cpu_time() - began)
            met = 0.0
            for share in REALISED:
                force = share * (with_return_strokes(plan) if closure == "strokes" else plan).met
                solver.reset()
                solution = solver.solve(position, force * direction)
                limits.append(usage(rig, solution.cycle).worst)
                miss = average_force(solution.cycle, position) - force * direction
                if np.max(np.abs(miss)) <= solver.options.tolerance:
                    met = force
                    break
            found.append(met)
            solver.reset()
            began = cpu_time()
            solver.solve(position, 0.5 * met * direction)
            solve_s.append(cpu_time() - began)
        milliseconds = 1e3 * np.array(solve_s[1:])
        rows.append(
            {
                "closure": closure,
                "p10": float(np.percentile(found[1:], 10)),
                "median": float(np.median(found[1:])),
                "limit": float(np.max(limits)),
                "milliseconds": float(np.median(milliseconds)),
                "p99": float(np.percentile(milliseconds, 99)),
                "plan": 1e3 * float(np.median(plan_s[1:])),
            }
        )
    return rows


def goal_of(rig: Rig, parts: int, seed: int, drift: float, period: float) -> Goal:
    """Ask every part at rest for a drift in a direction of its own."""
    position, direction = request(rig, parts, seed)
    nothing = np.zeros((parts, 2))
    friction = np.full(parts, rig.friction.accel)
    return Goal(position, nothing, drift * period * direction, nothing, friction)


def missed(goal: Goal, cycle: PlateCycle) -> np.ndarray:
    """Return the errors (2 M,) [m] of a cycle by a finer prediction than the search's."""
    return goal.error(goal.end(*finely_sampled(cycle)))[0]


def order_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Compare orders before and after correction."""
    rows = []
    for order in ("nearest", "priority", "simulated"):
        solver = RotationSolver(rig, order=order, restarts=0)
        options = solver.options
        before, after, seconds = [], [], []
        for seed in range(-1, count):
            goal = goal_of(rig, PARTS, max(seed, 0), 0.005, options.period)
            asked = np.linalg.norm(goal.displacement)
            solver.reset()
            began = cpu_time()
            solution = solver.steer(goal, 0.0, 0.0)
            seconds.append(cpu_time() - began)
            after.append(np.linalg.norm(missed(goal, solution.cycle)) / asked)
            solver.reset()
            family, start = solver.planned(goal)
            before.append(np.linalg.norm(missed(goal, family.cycle(start))) / asked)
        rows.append(
            {
                "order": order,
                "before": 100 * float(np.median(before[1:])),
                "after": 100 * float(np.median(after[1:])),
                "milliseconds": 1e3 * float(np.median(seconds[1:])),
            }
        )
    return rows


def moved_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Move parts by one cycle, and see where the simulator has them."""
    rows: list[dict[str, Any]] = []
    for parts in (2, 4, 6, 10):
        solver = RotationSolver(rig, restarts=RESTARTS if parts < PARTS else 4)
        period = solver.steering_period(parts)
        for drift in DRIFTS:
            shares, seconds = [], []
            for seed in range(-1, count):
                goal = goal_of(rig, parts, max(seed, 0), drift, period)
                solver.reset()
                began = cpu_time()
                size = drift * period
                solution = solver.steer(goal, 0.03 * size, 0.05 * size)
                seconds.append(cpu_time() - began)
                friction = rig.friction
                run = simulate(
                    solution.cycle, goal.position, goal.velocity, friction.mu, friction.gravity
                )
                miss = run.position[-1] - goal.position - goal.displacement
                shares.append(np.linalg.norm(miss) / np.linalg.norm(goal.displacement))
            rows.append(
                {
                    "parts": parts,
                    "drift": 1e3 * drift,
                    "median": 100 * float(np.median(shares[1:])),
                    "p90": 100 * float(np.percentile(shares[1:], 90)),
                    "milliseconds": 1e3 * float(np.median(seconds[1:])),
                    "p99": 1e3 * float(np.percentile(seconds[1:], 99)),
                }
            )
    return rows


def summary(
    forces: list[dict[str, Any]],
    times: list[dict[str, Any]],
    realised: list[dict[str, Any]],
    moved: list[dict[str, Any]],
) -> list[str]:
    """Sum up in sentences."""
    library, svd = forces[0], next(row for row in forces if row["method"] == "SVD")
    sequence, strokes = realised
    return [
        f"guaranteed at {PARTS} parts: {library['p10']:.3f} mu m g (10 % of trials have less), "
        f"by SVD on 24 centres {svd['p10']:.4f}",
        f"linear programme: {times[0]['milliseconds']:.2f} ms, from the last basis "
        f"{times[1]['milliseconds']:.2f}, HiGHS {times[2]['milliseconds']:.0f}",
        f"realised: {sequence['p10']:.3f} mu m g closed as a sequence, {strokes['p10']:.3f} by "
        f"return strokes, in {sequence['milliseconds']:.1f} ms",
        "moved by one cycle, missed at 2.5 / 5 / 10 mm/s: "
        + "; ".join(
            f"{m} parts "
            + " / ".join(f"{row['median']:.0f}" for row in moved if row["parts"] == m)
            + " %"
            for m in (2, 4, 6, 10)
        ),
    ]


def scatter(rig: Rig, parts: int, rng: np.random.Generator) -> np.ndarray:
    """Return random places (M, 2) [m] with the distance asked for."""
    chosen = np.empty((0, 2))
    while len(chosen) < parts:
        new = rng.uniform(-0.9, 0.9, 2) * rig.plate.half
        if np.all(np.hypot(*(chosen - new).T) >= APART * rig.plate.width_m):
            chosen = np.vstack([chosen, new])
    return chosen


def request(rig: Rig, parts: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places and unit vectors (M, 2) of a trial."""
    rng = np.random.default_rng([seed, parts])
    position = scatter(rig, parts, rng)
    angle = rng.uniform(0, 2 * np.pi, parts)
    return position, np.column_stack([np.cos(angle), np.sin(angle)])


def force_rows(rig: Rig, count: int) -> list[dict[str, Any]]:
    """Guaranteed forces by the library, and by few centres, in several ways."""
    half = rig.plate.half
    sets = {
        "library": Library.around(half),
        "24 on a grid": Library.about(grid(half), half),
        "24 on a ring": Library.about(ring(half), half),
    }
    rows = []
    for name, library in sets.items():
        rows.append(force_row(rig, name, "least time", count, partial(by_time, library)))
        if name != "library":
            rows.append(force_row(rig, name, "SVD", count, partial(by_svd, library)))
        rows[-1]["number"] = len(library.twist)
    few = [sets["24 on a grid"], sets["24 on a ring"]]
    rows.append(
        force_row(
            rig, "grid or ring", "SVD, better set", count,
            lambda p, f: max(by_svd(library, p, f) for library in few),
        )
    )  # fmt: skip
    return rows


def force_row(
    rig: Rig,
    centres: str,
    method: str,
    count: int,
    guaranteed: Callable[[np.ndarray, np.ndarray], float],
) -> dict[str, Any]:
    """Sum up the trials of one method."""
    found, worst = [], []
    library = Library.around(rig.plate.half)
    for seed in range(count):
        position, direction = request(rig, PARTS, seed)
        found.append(guaranteed(position, direction))
        if centres == "library":
            worst.append(worst_direction(library, position, seed))
    return {
        "centres": centres,
        "method": method,
        "number": 24,
        "p10": float(np.percentile(found, 10)),
        "median": float(np.median(found)),
        "worst_p10": float(np.percentile(worst, 10)) if worst else None,
    }


def by_time(library: Library, position: np.ndarray, direction: np.ndarray) -> float:
    """Guaranteed force of the least-time plan, closure included."""
    return 1 / plan_rotations(library, position, direction).times.cost


def by_svd(library: Library, position: np.ndarray, direction: np.ndarray) -> float:
    """Guaranteed force of the smallest weights: least component along the request, per time."""
    matrix = library.forces(position)
    weights, _ = solve_weights(matrix, direction.T.ravel(), GAIN)
    got = (matrix @ weights).reshape(2, -1).T
    return float(max(np.min(np.sum(got * direction, axis=1)), 0) / np.sum(np.abs(weights)))


def worst_direction(library: Library, position: np.ndarray, seed: int) -> float:
    """Guaranteed force in the worst directions that a search finds.

    Time is the greatest y . f over prices y that no rotation exceeds, so along the prices of a
    request it is greater still: f is turned along y until that is all.
    """
    rng = np.random.default_rng(seed)
    matrix, time = library.forces(position), 0.0
    ones, dear = np.ones(matrix.shape[1]), np.full(len(matrix), 1e4)
    for _ in range(WORST_STARTS):
        force = rng.normal(size=(2, len(position)))
        last = -1.0
        for _ in range(30):
            force /= np.maximum(np.hypot(*force), 1e-12)
            plan = least_time(matrix, force.ravel(), ones, dear, dear)
            if plan.cost <= last * (1 + 1e-6):
                break
            last, force = plan.cost, plan.price.reshape(2, -1).copy()
        time = max(time, last)
    return 1 / time
