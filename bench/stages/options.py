"""Error and time of both methods with their options, and of scipy, on the stick-slip cycle map.

Parts start at rest. Each request contains a different drift of each part over one cycle, without
tolerance and without a warm start. `plate_sim` checks all results. The baselines are scipy's least
squares with Method B's unknowns and the same prediction. One baseline uses scipy's finite
differences, the other the project's derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from harness import Result, Table, timed
from plate_core import PlateCycle, Rig, load_rig
from plate_sim import simulate
from plate_solver import (
    DRIFT_TOLERANCE,
    EFFORT,
    EXACT_MISS,
    Goal,
    Limits,
    RotationSolver,
    SinusoidSolver,
)
from plate_solver.sinusoids import Motions, Problem, descend, family_on_grid
from stages.scenes import random_positions

SEED = 50_000
"""First seed of the requests. The number of parts is added to this seed."""

DRIFT = 0.005
"""Maximum requested drift of a part along each axis [m/s]."""

CASES = {2: 20, 4: 12, 6: 10, 10: 8}
"""Number of requests, by number of parts."""

HARMONICS = {2: 8, 4: 8, 6: 8, 10: 12}
"""Number of harmonics, by number of parts. `SinusoidSolver` chooses the same numbers for exact
drifts."""

B_RESTARTS, A_RESTARTS, SCIPY_RESTARTS = (0, 1, 3, 10, 40), (0, 1, 4), (0, 3)
METHODS = {"A": "rotations", "B": "sinusoids"}

Contestant = Callable[[Goal], PlateCycle]


def measure(quick: bool) -> Result:
    """Solve the same requests with all methods in turn."""
    rig = load_rig()
    cases = {2: 2, 10: 1} if quick else CASES
    rows = [row for parts, count in cases.items() for row in rows_of(rig, parts, count)]
    return Result([Table.of("options", rows, drift=1e3 * DRIFT)])


def rows_of(rig: Rig, parts: int, count: int) -> list[dict[str, Any]]:
    """Run all methods with one number of parts. The first request is not counted."""
    rng = np.random.default_rng(SEED + parts)
    runners = make_contestants(rig, parts)
    goals = [make_request(rig, parts, rng) for _ in range(count + 1)]
    requested = [np.mean((goal.displacement / period_of(parts)) ** 2) for goal in goals[1:]]
    found: dict[tuple[str, str], list[tuple[float, float]]] = {key: [] for key in runners}
    for goal in goals:
        for key, run in runners.items():
            cycle, seconds = timed(run, goal)
            found[key].append((1e3 * seconds, drift_error(rig, goal, cycle)))
    rows = []
    for (method, option), pairs in found.items():
        ms, missed = np.array(pairs[1:]).T
        rows.append({
            "parts": parts, "method": method, "option": option, "runs": count,
            "default": is_default(method, option),
            "median_ms": np.median(ms), "p99_ms": np.percentile(ms, 99),
            "missed_percent": 100 * np.sqrt(np.mean(missed) / np.mean(requested)),
            "worst_percent": 100 * np.sqrt(np.max(missed / requested)),
        })  # fmt: skip
    return rows


def is_default(method: str, option: str) -> bool:
    """Whether `Controller` uses this method with this option."""
    return method in METHODS and option == f"{EFFORT[METHODS[method]]['restarts']} restarts"


def period_of(parts: int) -> float:
    """Return the length of the cycles [s]."""
    return SinusoidSolver(load_rig()).steering_period(parts)


def make_request(rig: Rig, parts: int, rng: np.random.Generator) -> Goal:
    """Return a request for drifts of parts at rest."""
    position = random_positions(rig, parts, rng)
    still, period = np.zeros_like(position), period_of(parts)
    displacement = period * rng.uniform(-DRIFT, DRIFT, position.shape)
    return Goal(position, still, displacement, still, np.array([rig.friction.accel]))


def drift_error(rig: Rig, goal: Goal, cycle: PlateCycle) -> float:
    """Return the mean square error of the simulated drift [(m/s)^2]."""
    run = simulate(cycle, goal.position, goal.velocity, rig.friction.mu, rig.friction.gravity)
    drift = (run.position[-1] - goal.position) / cycle.period
    drift_requested = goal.displacement / period_of(len(goal.position))
    return float(np.mean((drift_requested - drift) ** 2))


def tolerances(goal: Goal) -> tuple[float, float]:
    """Return the tolerance of a request and the maximum error of a met request [m], both as in
    `Controller`."""
    tolerance = DRIFT_TOLERANCE * period_of(len(goal.position))
    return tolerance, max(EXACT_MISS * goal.size, tolerance)


def make_contestants(rig: Rig, parts: int) -> dict[tuple[str, str], Contestant]:
    """Return functions that solve requests for a number of parts, by method and option."""
    found: dict[tuple[str, str], Contestant] = {}
    for restarts in B_RESTARTS:
        b = SinusoidSolver(rig, **EFFORT["sinusoids"] | {"restarts": restarts})
        found["B", f"{restarts} restarts"] = steered_contestant(b)
    for restarts in A_RESTARTS:
        a = RotationSolver(rig, **EFFORT["rotations"] | {"restarts": restarts})
        found["A", f"{restarts} restarts"] = steered_contestant(a)
    number, period = HARMONICS[parts], period_of(parts)
    b = SinusoidSolver(rig, harmonics=number, period=period, at_rest=True, restarts=3)
    found["B", "paper's map"] = averaged_contestant(b, period)
    found["A", "paper's map"] = averaged_contestant(
        RotationSolver(rig, period=period, restarts=1), period
    )
    for restarts in SCIPY_RESTARTS:
        for own_derivatives, derivatives in ((True, "own differences"), (False, "our derivatives")):
            search = ScipySearch(rig, parts, own_derivatives, restarts)
            found[f"scipy, {derivatives}", f"{restarts} restarts"] = search.solve
    return found


def steered_contestant(solver: SinusoidSolver | RotationSolver) -> Contestant:
    """Return a function that solves with the project's solver on the stick-slip map."""

    def run(goal: Goal) -> PlateCycle:
        solver.reset()
        return solver.steer(goal, *tolerances(goal)).cycle

    return run


def averaged_contestant(solver: SinusoidSolver | RotationSolver, period: float) -> Contestant:
    """Return a function that solves with the project's solver on the paper's averaged forces. From
    rest, a force f moves a part by f mu g T^2 / 2."""

    def run(goal: Goal) -> PlateCycle:
        solver.reset()
        unit = goal.friction_accel[:, None] * period**2 / 2
        return solver.solve(goal.position, goal.displacement / unit).cycle

    return run


class ScipySearch:
    """scipy's trust-region least squares with Method B's unknowns.

    Parameters
    ----------
    rig : Rig
    parts : int
    own : bool
        Whether scipy uses its finite differences. Otherwise scipy uses the project's derivatives.
    restarts : int
    """

    def __init__(self, rig: Rig, parts: int, own: bool, restarts: int) -> None:
        number, period = HARMONICS[parts], period_of(parts)
        limits = Limits.of(rig)
        self._family = family_on_grid(number, period, limits)
        self._motions = Motions.of(self._family.basis, limits)
        self._own, self._restarts = own, restarts

    def solve(self, goal: Goal) -> PlateCycle:
        """Return the best motion of all starts, within the limits."""
        rng = np.random.default_rng(0)
        _, good = tolerances(goal)
        best: Any = None
        for _ in range(self._restarts + 1):
            found = least_squares(
                lambda theta: self._errors(goal, theta),
                self._family.random(rng),
                "2-point" if self._own else lambda theta: self._slopes(goal, theta),
                max_nfev=EFFORT["sinusoids"]["iterations"],
            )
            if best is None or found.cost < best.cost:
                best = found
            if 2 * best.cost <= good**2 * goal.rows:
                break
        return self._family.cycle(best.x / max(self._family.use(best.x), 1.0))

    def _errors(self, goal: Goal, theta: np.ndarray) -> np.ndarray:
        """Return the errors of displacements, followed by the limit violations [m]."""
        error, _ = goal.error(goal.end(*self._family.samples(theta)))
        return np.append(error, np.linalg.norm(self._excess(goal, theta)[0]))

    def _slopes(self, goal: Goal, theta: np.ndarray) -> np.ndarray:
        by_pose, by_twist, _ = goal.end_slopes(*self._family.samples(theta))
        rows = -self._family.pull_back(by_twist, by_pose)
        excess, slopes_of_excess = self._excess(goal, theta)
        unit = excess / max(float(np.linalg.norm(excess)), 1e-300)
        return np.vstack([rows, -unit @ slopes_of_excess])

    def _excess(self, goal: Goal, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the limit violations (K,) [m], and their negative derivatives (K, P)."""
        found = descend(Problem.of(goal, self._motions, np.inf), theta, 0.0, 0)
        return found.error[goal.rows :], found.jacobian[goal.rows :]
