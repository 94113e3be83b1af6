"""Three maps on which a request may be met, each nearer to the truth and dearer than the last."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plate_core import PlateCycle

from ..cycle_map import after
from ..goal import Goal, Solution, Status
from .mean_force import average_force
from .request import Request

REFINEMENTS = ("none", "velocity", "cycle")
"""Names of the maps, see `ForceSolver.solve`."""

CYCLE_CORRECTIONS = 6
"""Times that a motion is corrected for what finer steps show."""

VELOCITY_CORRECTIONS = 20
"""Times that a motion is corrected for the velocities that it gives to the parts: each leaves about
half of the error."""

REFINED_TOLERANCE = 1e-3
"""Greatest force error that counts as success on a refined map [mu m g]; or the solver's own, if
that is greater."""

MISSED = 0.1
"""On a refined map, where most requests can be met only nearly, this fraction of the request may
be missed too (root mean square over parts and axes). The map without it misses more than all."""

STALE = 4
"""Corrections in a row that are no better than the best so far: there will be no better one."""

MOST_ON_CYCLE = 0.5
"""Full friction all along moves a part by half of mu g T^2: no force on the cycle map is greater
[mu m g]."""


def force_solution(
    request: Request,
    error: np.ndarray,
    cycle: PlateCycle,
    tolerance: float,
    iterations: int,
    condition: float,
) -> Solution:
    """Put a motion within the limits, and its errors in the rows asked for, into a solution."""
    worst = float(np.max(np.abs(error)))
    every = np.zeros(len(request.rows))
    every[request.rows] = error
    success = worst <= tolerance
    message = f"force error {worst:.2g} mu m g after {iterations} iterations"
    return Solution(
        success=success,
        message=message if success else f"{message}, allowed: {tolerance:g}",
        cycle=cycle,
        residual=every.reshape(-1, 3)[:, :2],
        iterations=iterations,
        condition=condition,
    )


def judged(request: Request, solution: Solution, error: np.ndarray, bound: float) -> Solution:
    """Return the solution with force errors (M, 2), and whether they are within the slack."""
    worst = float(np.max(np.abs(error) - request.tolerance))
    success = worst <= bound
    message = f"force error {np.max(np.abs(error)):.2g} mu m g"
    if not success:
        message += f", {worst:.2g} beyond what is tolerated, allowed: {bound:.2g}"
    return replace(
        solution,
        success=success,
        message=message,
        residual=error,
        status=Status.SOLVED if success else solution.status,
        fraction=1.0 if success else 0.0,
    )


def refined(request: Request, solution: Solution, error: np.ndarray, bound: float) -> Solution:
    """Return the solution with force errors (M, 2), and whether that is good for a refined map."""
    allowed = MISSED * float(np.sqrt(np.mean(request.force**2)))
    enough = _spill(request, error) <= allowed
    return judged(
        request, replace(solution, status=Status.FAILED), error, np.inf if enough else bound
    )


def on_mean_velocity(
    request: Request, solve: Callable[[Request], Solution], friction_accel: float, bound: float
) -> Solution:
    """Solve with the velocities that parts have on average over the cycle under its motion.

    Velocities and motion are found in turns, each from the last.
    """
    velocity = request.velocity

    def correct() -> tuple[Solution, np.ndarray]:
        nonlocal velocity
        found = solve(replace(request, velocity=velocity))
        end, _ = after(found.cycle, request.position, request.velocity, friction_accel)
        velocity = (end - request.position) / found.cycle.period
        return found, request.force - average_force(found.cycle, request.position, velocity)

    return _best_of(request, correct, VELOCITY_CORRECTIONS, bound)


def on_cycle(
    request: Request,
    steer: Callable[[Goal, float, float], Solution],
    period: float,
    friction_accel: float,
    bound: float,
) -> Solution:
    """Solve on the cycle map; what finer steps show to be missed is aimed at again."""
    unit = friction_accel * period**2
    position, velocity, slack = request.position, request.velocity, request.tolerance
    good = max(bound, MISSED * float(np.sqrt(np.mean(request.force**2)))) / 4
    force = request.force

    def correct() -> tuple[Solution, np.ndarray]:
        nonlocal force
        goal = Goal(
            position,
            velocity,
            velocity * period + force * unit,
            slack * unit,
            np.full(len(position), friction_accel),
        )
        found = steer(goal, 0.1 * bound * unit, good * unit)
        end, _ = after(found.cycle, position, velocity, friction_accel)
        error = request.force - (end - position - velocity * period) / unit
        force = force + np.sign(error) * np.maximum(np.abs(error) - slack, 0.0)
        return found, error

    return _best_of(request, correct, CYCLE_CORRECTIONS, bound)


def _best_of(
    request: Request, correct: Callable[[], tuple[Solution, np.ndarray]], most: int, bound: float
) -> Solution:
    """Correct again and again, until it is good or does not help; keep the best."""
    best: Solution | None = None
    least, stale, iterations = np.inf, 0, 0
    for _ in range(most):
        found, error = correct()
        iterations += found.iterations
        missed = _spill(request, error)
        stale = 0 if missed < least else stale + 1
        if best is None or missed < least:
            best, least = refined(request, found, error, bound), missed
        if (best.success and least <= bound) or stale == STALE:
            break
    assert best is not None
    return replace(best, iterations=iterations)


def _spill(request: Request, error: np.ndarray) -> float:
    """Return the root mean square of errors (M, 2) beyond the slack [mu m g]."""
    return float(np.sqrt(np.mean(np.maximum(np.abs(error) - request.tolerance, 0.0) ** 2)))
