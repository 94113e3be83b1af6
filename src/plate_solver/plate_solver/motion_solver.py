"""What both methods have in common: cycles that take parts to a goal, and checked options."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from plate_core import PlateError, Rig

from .goal import Goal, Solution
from .limits import Limits


def make_options(kind: type[Any], options: dict[str, Any]) -> Any:
    """Return options of a kind; an unknown one is refused with the names of those there are."""
    known = kind.__dataclass_fields__
    unknown = [name for name in options if name not in known]
    if unknown:
        raise PlateError(f"options are {', '.join(options)}, allowed: {', '.join(known)}")
    return kind(**options)


def check_options(options: object, **ranges: tuple[float, float]) -> None:
    """Check that options are numbers in their ranges; whole ones where the range is whole.

    Raises
    ------
    PlateError
        Naming the option, its value and what is allowed.
    """
    for name, (low, high) in ranges.items():
        value = getattr(options, name)
        whole = isinstance(low, int)
        numeric = isinstance(value, int if whole else int | float) and not isinstance(value, bool)
        if not numeric or not low <= value <= high:
            allowed = f"{low:g} to {high:g}" + (", a whole number" if whole else "")
            raise PlateError(f"{name} is {value!r}, allowed: {allowed}")


class MotionSolver(ABC):
    """Finds closed plate motions; remembers the last one as a start for the next.

    Attributes
    ----------
    cut_short : int
        Searches of `steer` that were ended by the time.
    """

    options: Any

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._limits, self._full = Limits.of(rig), Limits.of(rig, 1.0)
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self.cut_short = 0

    def reset(self) -> None:
        """Forget the last solution and start the random numbers anew."""
        self._rng = np.random.default_rng(self._seed)
        self.forget()

    @abstractmethod
    def forget(self) -> None:
        """Forget the last solution: the next search begins afresh."""

    @abstractmethod
    def steer(
        self, goal: Goal, tolerance: float, good_enough: float, until: float = math.inf
    ) -> Solution:
        """Find a motion that moves parts as asked, on the cycle map.

        Parameters
        ----------
        goal : Goal
            Start state and wanted displacements.
        tolerance : float
            Greatest error at which to stop [m].
        good_enough : float
            Root mean square error [m] above which other starts are tried.
        until : float
            When the answer is to be there, by `time.monotonic` [s]: then the search ends sooner,
            and what it finds depends on the computer.

        Returns
        -------
        Solution
            `residual` is the displacement error in mu m g: error / (mu g T^2).
        """

    @abstractmethod
    def steering_period(
        self, count: int, turns: int = 0, lasting: bool = False, goes_on: bool = False
    ) -> float:
        """Period [s] of the cycles that `steer` makes for `count` parts, so many of which turn;
        lasting: as in `Goal`; goes_on: whether the state of the plate is given there."""
