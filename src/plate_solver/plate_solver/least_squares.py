"""Damped Gauss-Newton (Levenberg-Marquardt) for a few errors and many parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FIRST_DAMPING = 1e-2
LEAST_DAMPING = 1e-6
MOST_DAMPING = 1e3


@dataclass(frozen=True)
class Fit:
    """Result: parameters (P,), errors (R,) and their Jacobian (R, P), iterations, cost."""

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
        values = np.linalg.svd(self.jacobian, compute_uv=False)
        return float(values[0] / values[-1]) if values[-1] > 0 else float("inf")


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, Callable[[], np.ndarray]]],
    parameters: np.ndarray,
    admissible: Callable[[np.ndarray], np.ndarray],
    tolerance: float,
    iterations: int,
) -> Fit:
    """Reduce the errors until the greatest is below `tolerance`.

    Parameters
    ----------
    evaluate : function
        Parameters (P,) to errors (R,), and a function for the derivative (R, P) of MINUS the
        errors there: it is called only where a step is taken.
    parameters : (P,)
        Admissible start.
    admissible : function
        Maps parameters to ones that the rig can run.
    tolerance : float
        Greatest absolute error at which to stop.
    iterations : int
        Most evaluations after the first.
    """
    error, slopes = evaluate(parameters)
    jacobian = slopes()
    cost = error @ error
    damping = FIRST_DAMPING
    done = 0
    while np.max(np.abs(error), initial=0.0) > tolerance and done < iterations:
        done += 1
        step = _step(jacobian, error, damping)
        trial = admissible(parameters + step)
        trial_error, slopes = evaluate(trial)
        trial_cost = trial_error @ trial_error
        if trial_cost < cost:
            parameters, error, cost = trial, trial_error, trial_cost
            jacobian = slopes()
            damping = max(damping / 3, LEAST_DAMPING)
        else:
            damping *= 4
            if damping > MOST_DAMPING:
                break
    return Fit(parameters, error, jacobian, done)


def _step(jacobian: np.ndarray, error: np.ndarray, damping: float) -> np.ndarray:
    """Solve in the smaller of the two spaces: errors or parameters."""
    rows, columns = jacobian.shape
    small = jacobian @ jacobian.T if rows <= columns else jacobian.T @ jacobian
    size = len(small)
    small[np.diag_indices(size)] += damping * np.trace(small) / size + 1e-30
    if rows <= columns:
        return jacobian.T @ np.linalg.solve(small, error)
    return np.linalg.solve(small, jacobian.T @ error)
