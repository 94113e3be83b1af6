"""Result of a solver: the motion, and the fraction of the request that it meets. `Status` is the
outcome: solved, partially solved, infeasible or failed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from plate_core import PlateCycle


class Status(Enum):
    """Outcome of a request."""

    SOLVED = "solved"
    """The request is met."""
    PARTIAL = "partial"
    """A fraction of the request is met."""
    UNREACHABLE = "unreachable"
    """It is proven that no motion meets the request. `fraction` is the fraction that is met."""
    FAILED = "failed"
    """No fraction is met, and infeasibility is not proven."""


@dataclass(frozen=True)
class Solution:
    """Result of a solver.

    Attributes
    ----------
    success : bool
        Whether the request is met within the solver's tolerance.
    message : str
        Accuracy of the result, or the reason of a failure.
    cycle : PlateCycle
        The motion. It is closed and within the limits of the rig, even if `success` is False.
    residual : (M, 2)
        Request minus predicted result [mu m g]. The residual refers to the whole request, even if
        only a fraction is met.
    iterations : int
        Number of iterations, summed over all starts.
    condition : float
        Condition number of the last linear system. The condition number is large if it is hard to
        move the parts independently.
    status : Status
        Outcome of the request.
    fraction : float
        Feasible fraction of the request; 1 if the request is met. The motion achieves this
        fraction. There is one exception: with the argument `refine` of `ForceSolver.solve`, `cycle`
        may be a motion that has a smaller error for the whole request.
    predicted : (C,), optional
        Predicted end of the parts on the cycle map: x of all parts [m], y of all parts and, if
        rotations are requested, the rotations of all parts [rad].
    """

    success: bool
    message: str
    cycle: PlateCycle
    residual: np.ndarray
    iterations: int
    condition: float
    status: Status = Status.FAILED
    fraction: float = 0.0
    predicted: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.success:
            object.__setattr__(self, "status", Status.SOLVED)
            object.__setattr__(self, "fraction", 1.0)
