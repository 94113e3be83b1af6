"""Solves a request on refined force maps. A solution on a simpler map is corrected repeatedly.

There are three force maps. `velocity` is more accurate than `none` and needs more computing time.
`cycle` is more accurate than `velocity` and needs still more computing time. The functions return a
`Solution` with the errors on the refined map.
"""

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
"""Names of the force maps, see `ForceSolver.solve`."""

CYCLE_CORRECTIONS = 6
"""Maximum number of corrections on the force map `cycle`. Each correction compensates the force
error of the last motion, which is computed with finer time steps."""

VELOCITY_CORRECTIONS = 20
"""Maximum number of corrections on the force map `velocity`. Each correction uses the mean
velocities of the parts under the last motion. A correction approximately halves the force error."""

REFINED_TOLERANCE = 1e-3
"""Maximum force error that counts as success on the force maps `velocity` and `cycle` [mu m g]. If
the tolerance of the solver is larger, it is used instead."""

MISSED = 0.1
"""Maximum error that counts as success on the force maps `velocity` and `cycle`, as a fraction of
the request. Both are root mean squares over parts and axes. On these maps, most requests can be met
only approximately. For comparison, a solution for the map `none` without corrections has an error
on these maps that is larger than the request."""

STALE = 4
"""Number of consecutive corrections without an improvement after which the search ends."""

MAX_ON_CYCLE = 0.5
"""Maximum force on the force map `cycle` [mu m g]. Friction is at most mu m g. During a cycle of
length T, a part that starts at rest therefore moves by at most mu g T^2 / 2."""


def force_solution(
    request: Request,
    error: np.ndarray,
    cycle: PlateCycle,
    tolerance: float,
    iterations: int,
    condition: float,
) -> Solution:
    """Return the `Solution` for a motion that is within the limits of the rig. `error` contains the
    errors of the requested components (`Request.rows`) [mu m g]."""
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


def evaluated(request: Request, solution: Solution, error: np.ndarray, bound: float) -> Solution:
    """Return a copy of the solution with the force errors `error` (M, 2) [mu m g]. The copy is a
    success if no error exceeds the tolerance of the request by more than `bound` [mu m g]."""
    worst = float(np.max(np.abs(error) - request.tolerance))
    success = worst <= bound
    message = f"force error {np.max(np.abs(error)):.2g} mu m g"
    if not success:
        message += f", {worst:.2g} above the tolerance, allowed: {bound:.2g}"
    return replace(
        solution,
        success=success,
        message=message,
        residual=error,
        status=Status.SOLVED if success else solution.status,
        fraction=1.0 if success else 0.0,
    )


def refined(request: Request, solution: Solution, error: np.ndarray, bound: float) -> Solution:
    """Return a copy of the solution with the force errors `error` (M, 2) [mu m g] on the map
    `velocity` or `cycle`. The copy is a success under the condition of `evaluated`, or if the root
    mean square error is at most `MISSED` times the request."""
    allowed = MISSED * float(np.sqrt(np.mean(request.force**2)))
    enough = _spill(request, error) <= allowed
    return evaluated(
        request, replace(solution, status=Status.FAILED), error, np.inf if enough else bound
    )


def on_mean_velocity(
    request: Request, solve: Callable[[Request], Solution], friction_accel: float, bound: float
) -> Solution:
    """Solve a request on the force map `velocity`. The map `velocity` uses the mean velocities that
    the parts have over the cycle under the returned motion.

    A fixed-point iteration computes the motion from the velocities, then the velocities from the
    motion, and repeats both.
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
    """Solve a request on the force map `cycle`. After each solution, the error is computed with
    finer time steps. The portion of the error that exceeds the tolerance is then added to the
    requested force."""
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
    request: Request,
    correct: Callable[[], tuple[Solution, np.ndarray]],
    max_attempts: int,
    bound: float,
) -> Solution:
    """Call `correct` repeatedly, until the result is good enough or no longer improves. Return the
    best result."""
    best: Solution | None = None
    min_error, stale, iterations = np.inf, 0, 0
    for _ in range(max_attempts):
        found, error = correct()
        iterations += found.iterations
        missed = _spill(request, error)
        stale = 0 if missed < min_error else stale + 1
        if best is None or missed < min_error:
            best, min_error = refined(request, found, error, bound), missed
        if (best.success and min_error <= bound) or stale == STALE:
            break
    assert best is not None
    return replace(best, iterations=iterations)


def _spill(request: Request, error: np.ndarray) -> float:
    """Return the root mean square of the portions of the errors (M, 2) that exceed the tolerance
    [mu m g]."""
    return float(np.sqrt(np.mean(np.maximum(np.abs(error) - request.tolerance, 0.0) ** 2)))
