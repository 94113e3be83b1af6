"""Levenberg-Marquardt for a few errors and many parameters.

Steps are of least norm, so they are orthogonal to whatever does not change the errors: on the
averaged map, scale and shift in time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import _kernels


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
        return condition_of(self.jacobian)


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, Callable[[], np.ndarray]]],
    admissible: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Search by functions of Python.

    Parameters
    ----------
    evaluate : function
        Parameters to errors, and to a function for the derivative of minus the errors there.
    admissible : function
        Parameters to ones that the rig can run.
    start : (P,)
    tolerance : float
        Greatest absolute error at which to stop.
    iterations : int
        How often to evaluate at most after the first time. Derivatives are asked for only where a
        step is taken.
    """
    return Fit(*_kernels.fit(evaluate, admissible, start, tolerance, iterations))


def least_norm_step(jacobian: np.ndarray, error: np.ndarray, damping: float) -> np.ndarray:
    """Return the damped step: J' (J J' + damping mean(diag) 1)^-1 error, or the same in the space
    of the parameters where that is the smaller one."""
    return _kernels.least_norm_step(jacobian, error, damping)


def condition_of(jacobian: np.ndarray) -> float:
    """Return the condition number (infinite where it is beyond 1e7)."""
    return _kernels.condition_of(jacobian)
