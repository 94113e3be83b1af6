"""Base class of the solvers of both methods, and the checks of their options.

`MotionSolver.steer` finds a cycle for a `Goal` on the cycle map. Each search starts from the
solution of the last search.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from plate_core import PlateError, Rig

from .goal import Goal, Solution
from .limits import Limits


def make_options(kind: type[Any], options: dict[str, Any]) -> Any:
    """Return the options of a solver. If an option is unknown, the error lists the names of all
    options."""
    known = kind.__dataclass_fields__
    unknown = [name for name in options if name not in known]
    if unknown:
        raise PlateError(f"options are {', '.join(options)}, allowed: {', '.join(known)}")
    return kind(**options)


def check_options(options: object, **ranges: tuple[float, float]) -> None:
    """Check that options are numbers within their ranges.

    If the lower end of a range is an integer, the option must be an integer.

    Raises
    ------
    PlateError
        If an option is invalid. The error names the option, its value and the allowed range.
    """
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        is_integer = isinstance(low, int)
        numeric = isinstance(value, int if is_integer else int | float) and not isinstance(
            value, bool
        )
        if not numeric or not low <= value <= high:
            allowed = f"{low:g} to {high:g}" + (", a whole number" if is_integer else "")
            raise PlateError(f"{name} is {value!r}, allowed: {allowed}")


class MotionSolver(ABC):
    """Solver that finds closed plate motions. The last motion is the start of the next search.

    Attributes
    ----------
    cut_short : int
        Number of searches by `steer` that ended at the deadline.
    """

    options: Any

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._limits, self._full = Limits.of(rig), Limits.of(rig, 1.0)
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self.cut_short = 0

    def reset(self) -> None:
        """Forget the last solution and reset the random generator to its seed."""
        self._rng = np.random.default_rng(self._seed)
        self.forget()

    @abstractmethod
    def forget(self) -> None:
        """Forget the last solution, so that the next search does not start from it."""

    @abstractmethod
    def steer(
        self, goal: Goal, tolerance: float, good_enough: float, until: float = math.inf
    ) -> Solution:
        """Find a motion that moves the parts to the goal, as predicted by the cycle map.

        Parameters
        ----------
        goal : Goal
            Initial state and requested displacements of the parts.
        tolerance : float
            A descent stops when its largest error is at most this value [m].
        good_enough : float
            The search stops when the root mean square error is at most this value [m]. Otherwise
            the search continues from further starts.
        until : float
            Deadline on the clock `time.monotonic` [s]. A finite deadline may end the search early.
            If the deadline ends the search, the result depends on the speed of the computer.

        Returns
        -------
        Solution
            Result of the search. The field `residual` of the solution is the displacement error
            divided by mu g T^2.
        """

    @abstractmethod
    def steering_period(
        self, count: int, rotating_parts: int = 0, multi_cycle: bool = False, free_end: bool = False
    ) -> float:
        """Return the period [s] of the cycles that `steer` computes for `count` parts.

        `rotating_parts` is the number of parts with a requested rotation. `multi_cycle` and
        `free_end` are as in `Goal`. Both have no effect on sequences of rotations, which always end
        at rest.
        """
