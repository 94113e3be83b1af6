"""Result of a solver. The result contains the motion, and the fraction of the request that this
motion meets. `Status` states whether the request is solved, partially solved, infeasible or
failed."""

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
    """It is proven that no motion meets the request. The attribute `fraction` is the fraction of
    the request that the result meets."""
    FAILED = "failed"
    """No fraction of the request is met, and it is not proven that the request is infeasible."""


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
        Motion of the plate. The motion is closed and within the limits of the rig, even if
        `success` is False.
    residual : (M, 2)
        Request minus predicted result [mu m g]. The residual refers to the whole request, even if
        only a fraction is met.
    iterations : int
        Number of iterations, summed over all starts.
    condition : float
        Condition number of the last linear system of the search. The condition number is large if
        it is hard to move the parts independently.
    status : Status
        Outcome of the request.
    fraction : float
        Fraction of the request that the motion meets. 1 if the request is met. There is one
        exception. With the argument `refine` of `ForceSolver.solve`, `cycle` can be another motion
        that has a smaller error for the whole request.
    predicted : (C,), optional
        Coordinates of the parts at the end of the cycle, predicted by the cycle map. The
        coordinates are x of all parts [m], then y of all parts. If rotations are requested, the
        rotations of all parts follow [rad].
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
