"""Levenberg-Marquardt method for few errors and many parameters.

With the negative Jacobian J of the errors e and the damping d, the step of minimum norm is

    J' (J J' + d mean(diag(J J')) 1)^-1 e.

These steps are orthogonal to all directions that do not change the errors. For the averaged map,
these directions are a change of amplitude and a shift in time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import _kernels


class Fit(NamedTuple):
    """Result of a fit: parameters (P,), errors (R,), negative Jacobian (R, P), and number of
    steps."""

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
        """Condition number of the Jacobian (infinite if it is rank-deficient)."""
        return condition_of(self.jacobian)


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, Callable[[], np.ndarray]]],
    admissible: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Minimise errors that a Python function computes.

    Parameters
    ----------
    evaluate : function
        Function of the parameters that returns a pair: the errors, and a function that returns the
        negative derivatives of the errors. The second function is called only if a step is taken.
    admissible : function
        Function that maps parameters to the nearest ones that the rig can run.
    start : (P,)
    tolerance : float
        The search stops when the largest absolute error is at most this value.
    iterations : int
        Maximum number of evaluations after the evaluation at `start`.
    """
    return Fit(*_kernels.fit(evaluate, admissible, start, tolerance, iterations))


def condition_of(jacobian: np.ndarray) -> float:
    """Return the condition number of the Jacobian. The condition number is infinite if it exceeds
    1e7."""
    return _kernels.condition_of(jacobian)
