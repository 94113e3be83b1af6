"""Levenberg-Marquardt method for few errors and many parameters.

Let e be the errors, J the negative Jacobian of e, and d the damping. The step of minimum norm is

    J' (J J' + d mean(diag(J J')) 1)^-1 e.

Such a step is orthogonal to all changes of the parameters that do not change the errors. For the
averaged map, these are a change of the amplitude of the motion and a shift in time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import _kernels


class Fit(NamedTuple):
    """Result of a fit. The result contains the parameters (P,), the errors (R,), the negative
    Jacobian (R, P) of the errors, and the number of steps."""

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
        """Condition number of the Jacobian. Infinite if it exceeds 1e7."""
        return _kernels.condition_of(self.jacobian)


def fit(
    evaluate: Callable[[np.ndarray], tuple[np.ndarray, Callable[[], np.ndarray]]],
    admissible: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Minimise the squared errors that a Python function computes.

    Parameters
    ----------
    evaluate : function
        Function of the parameters. The function returns the errors, and another function that
        returns the negative derivatives of the errors. The other function is called only if the
        derivatives are needed.
    admissible : function
        Function that changes parameters to the nearest parameters that the rig can execute.
    start : (P,)
    tolerance : float
        The search stops when the largest absolute error is at most this value.
    iterations : int
        Maximum number of evaluations after the evaluation at `start`.
    """
    return Fit(*_kernels.fit(evaluate, admissible, start, tolerance, iterations))
