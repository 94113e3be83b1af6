"""Levenberg-Marquardt for a few errors and many parameters.

Steps are of least norm, so they are orthogonal to whatever does not change the errors: on the
averaged map, scale and shift in time.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from plate_core.kernels import SAME_ROUNDING, kernel


class Damping(NamedTuple):
    """How the damping of steps changes, in units of the mean squared row of the Jacobian.

    Attributes
    ----------
    first, least, most : float
        A search that needs more than the most is given up.
    shrink, grow : float
        Factors after a step that was taken, and after one that was not.
    stall_steps : int
        A search is given up where so many steps leave
    stall_fraction : float
        more than this fraction of the squared error.
    """

    first: float
    least: float
    most: float
    shrink: float
    grow: float
    stall_steps: int
    stall_fraction: float


DAMPING = Damping(1e-2, 1e-6, 1e3, 3.0, 4.0, 1_000_000, 1.0)
"""Where each evaluation is expensive: it tries longer, and never counts as stalled."""


FEW_ROWS = 12
"""Up to which loops are done sooner than a library, whose code alone, where other work has come
between, takes some 40 us to fetch."""

SWEEPS, ORTHOGONAL = 16, 1e-6
"""Rounds of Jacobi's rotations at most, and the cosine of two rows that ends them: eigenvalues err
by its square."""


class Fit(NamedTuple):
    """Result: parameters (P,), errors (R,), Jacobian (R, P) of minus these, and steps made."""

    parameters: np.ndarray
    error: np.ndarray
    jacobian: np.ndarray
    iterations: int

    @property
    def cost(self) -> float:
        """Sum of squared errors."""
        return float(self.error @ self.error)

    @property
    def condition(self) -> float:
        """Condition number of the Jacobian (infinite where it has lost rank)."""
        return float(condition_of(np.ascontiguousarray(self.jacobian)))


Evaluate = Callable[[Any, np.ndarray], tuple[np.ndarray, np.ndarray, Any]]
"""Parameters (P,) to the nearest ones that the rig can run, their errors (R,), and notes."""

Slopes = Callable[[Any, np.ndarray, Any], np.ndarray]
"""These parameters and notes to the derivative (R, P) of MINUS the errors."""


def levenberg_marquardt(
    evaluate: Evaluate, slopes: Slopes
) -> Callable[[Any, np.ndarray, Damping, float, int], Fit]:
    """Make a search of two functions: plain, or to be compiled with compiled ones.

    The search takes a problem, which is given to both functions, a start (P,), the damping, the
    greatest absolute error at which to stop, and how often to evaluate at most after the first
    time. The slopes are asked for only where a step is taken.
    """

    def search(
        problem: Any, start: np.ndarray, damping: Damping, tolerance: float, iterations: int
    ) -> Fit:
        parameters, error, notes = evaluate(problem, start)
        jacobian = slopes(problem, parameters, notes)
        cost, factor, done = _squared(error), damping.first, 0
        history = np.empty(iterations + 1)
        while np.max(np.abs(error)) > tolerance and done < iterations:
            history[done] = cost
            past = done - damping.stall_steps
            if past >= 0 and cost > damping.stall_fraction * history[past]:
                break
            done += 1
            step = least_norm_step(jacobian, error, factor)
            trial, trial_error, notes = evaluate(problem, parameters + step)
            trial_cost = _squared(trial_error)
            if trial_cost < cost:
                parameters, error, cost = trial, trial_error, trial_cost
                jacobian = slopes(problem, parameters, notes)
                factor = max(factor / damping.shrink, damping.least)
            else:
                factor *= damping.grow
                if factor > damping.most:
                    break
        return Fit(parameters, error, jacobian, done)

    return search


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, Callable[[], np.ndarray]]],
    admissible: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Search by functions that are not compiled.

    Parameters
    ----------
    evaluate : function
        Parameters to errors, and to a function for the derivative of minus the errors there.
    admissible : function
        Parameters to ones that the rig can run.
    start, tolerance, iterations
        As `levenberg_marquardt`.
    """

    def there(_: None, trial: np.ndarray) -> tuple[np.ndarray, np.ndarray, Callable[[], Any]]:
        trial = admissible(trial)
        return trial, *evaluate(trial)

    def slopes(_: None, __: np.ndarray, at: Callable[[], np.ndarray]) -> np.ndarray:
        return at()

    return levenberg_marquardt(there, slopes)(None, start, DAMPING, tolerance, iterations)


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def least_norm_step(jacobian: np.ndarray, error: np.ndarray, damping: float) -> np.ndarray:
    """Return the damped step: J' (J J' + damping mean(diag) 1)^-1 error, or the same in the space
    of the parameters where that is the smaller one."""
    rows, columns = jacobian.shape
    if rows <= columns:
        weights = error.copy()
        _solve_damped(jacobian, damping, weights)
        step = np.zeros(columns)
        for i in range(rows):
            for c in range(columns):
                step[c] += weights[i] * jacobian[i, c]
        return step
    across = np.ascontiguousarray(jacobian.T)
    step = across @ error
    _solve_damped(across, damping, step)
    return step


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _solve_damped(rows: np.ndarray, damping: float, right: np.ndarray) -> None:
    """Solve (rows rows' + damping mean(diag) 1) x = right in place, by Cholesky's method."""
    count, square = len(rows), _products(rows)
    more = damping * np.trace(square) / count + 1e-30
    for i in range(count):
        square[i, i] += more
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= square[i, k] * square[j, k]
            square[i, j] = sqrt(max(total, 1e-300)) if i == j else total / square[j, j]
        for k in range(i):
            right[i] -= square[i, k] * right[k]
        right[i] /= square[i, i]
    for i in range(count - 1, -1, -1):
        for k in range(i + 1, count):
            right[i] -= square[k, i] * right[k]
        right[i] /= square[i, i]


@kernel(fastmath=SAME_ROUNDING)
def _squared(error: np.ndarray) -> float:
    total = 0.0
    for value in error:
        total += value * value
    return total


@kernel(fastmath=SAME_ROUNDING, error_model="numpy")
def _products(rows: np.ndarray) -> np.ndarray:
    """Return the scalar products of any two rows."""
    count = len(rows)
    square = np.empty((count, count))
    if count > FEW_ROWS:
        square[:] = rows @ rows.T
        return square
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for c in range(rows.shape[1]):
                total += rows[i, c] * rows[j, c]
            square[i, j] = square[j, i] = total
    return square


@kernel(error_model="numpy")
def condition_of(jacobian: np.ndarray) -> float:
    """Return the condition number (infinite where it is beyond 1e7)."""
    rows, columns = jacobian.shape
    square = _products(jacobian if rows <= columns else np.ascontiguousarray(jacobian.T))
    if len(square) > FEW_ROWS:
        values = np.linalg.eigvalsh(square)
    else:
        _rotate(square)
        values = np.diag(square)
    least, most = np.min(values), np.max(values)
    return sqrt(most / least) if least > 1e-14 * most else np.inf


@kernel(error_model="numpy")
def _rotate(square: np.ndarray) -> None:
    """Make a symmetric matrix diagonal by Jacobi's rotations."""
    count = len(square)
    for _ in range(SWEEPS):
        turned = False
        for i in range(count):
            for j in range(i):
                cross, product = square[i, j], square[i, i] * square[j, j]
                if abs(cross) <= ORTHOGONAL * sqrt(max(product, 0.0)):
                    continue
                turned = True
                half = (square[j, j] - square[i, i]) / (2 * cross)
                tangent = (1.0 if half >= 0 else -1.0) / (abs(half) + sqrt(1 + half * half))
                cosine = 1 / sqrt(1 + tangent * tangent)
                sine = cosine * tangent
                for k in range(count):
                    a, b = square[k, i], square[k, j]
                    square[k, i], square[k, j] = cosine * a - sine * b, sine * a + cosine * b
                for k in range(count):
                    a, b = square[i, k], square[j, k]
                    square[i, k], square[j, k] = cosine * a - sine * b, sine * a + cosine * b
        if not turned:
            break
