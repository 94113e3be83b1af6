"""A solution: the motion that a solver has found, and how much of the request it meets."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from plate_core import PlateCycle


class Status(Enum):
    """How a request fared."""

    SOLVED = "solved"
    """Met."""
    PARTIAL = "partial"
    """A fraction of it is met."""
    UNREACHABLE = "unreachable"
    """Beyond what any motion can do, proven; `fraction` tells how much is met all the same."""
    FAILED = "failed"
    """Nothing of it is met, and nothing is proven."""


@dataclass(frozen=True)
class Solution:
    """A solver's answer.

    Attributes
    ----------
    success : bool
        Whether the request is met within the solver's tolerance.
    message : str
        What was reached, or why not.
    cycle : PlateCycle
        The motion found: closed, within the rig's limits, also when `success` is false.
    residual : (M, 2)
        Request minus prediction, in mu m g: of the whole request, also where a fraction is met.
    iterations : int
        Steps of the iterative part, all starts together.
    condition : float
        Condition number of the last linear system: large where parts are hard to tell apart.
    status : Status
        As `success`, and why not.
    fraction : float
        Fraction of the request, in its direction, that is found to be possible: 1 where it is met.
        The motion does it, unless another misses less of the whole (`refine`).
    predicted : (Q,), optional
        Where a motion found on the cycle map is predicted to take the parts: x of all [m], y of
        all, then the turns that were asked for [rad].
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
