"""What both methods have in common: the two problems that a solver solves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from plate_core import PlateError, Rig

from .solution import Bounds, Request, Solution
from .steering import Goal


def make_options(kind: type[Any], options: dict[str, Any], *others: str) -> Any:
    """Return options of a kind; an unknown one is refused with the names of those there are."""
    known = kind.__dataclass_fields__
    unknown = [name for name in options if name not in known]
    if unknown:
        allowed = ", ".join((*others, *known))
        raise PlateError(f"options are {', '.join(options)}, allowed: {allowed}")
    return kind(**options)


class MotionSolver(ABC):
    """Finds closed plate motions; remembers the last one as a start for the next."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._bounds = Bounds.of(rig)
        self._seed = seed
        self._rng = np.random.default_rng(seed)

    def reset(self) -> None:
        """Forget the last solution and start the random numbers anew."""
        self._rng = np.random.default_rng(self._seed)
        self.forget()

    @abstractmethod
    def forget(self) -> None:
        """Forget the last solution: the next search begins afresh."""

    def solve(
        self,
        position: np.ndarray,
        force: np.ndarray,
        velocity: np.ndarray | None = None,
        curl: np.ndarray | None = None,
    ) -> Solution:
        """Find a closed motion with the wanted average forces, equations (5) and (9).

        Parameters
        ----------
        position : (M, 2)
            Parts [m], plate_home.
        force : (M, 2)
            Wanted average forces [mu m g].
        velocity : (M, 2), optional
            Parts' velocities [m/s]; zero if left out.
        curl : (M,), optional
            Wanted curl of the averaged field [mu m g / m]; NaN where it is free.

        Returns
        -------
        Solution

        Raises
        ------
        PlateError
            If shapes are wrong or values are not finite.
        """
        return self._solve(Request.check(position, force, velocity, curl))

    @abstractmethod
    def _solve(self, request: Request) -> Solution:
        """Do as `solve`, for a request that is checked."""

    @abstractmethod
    def steer(self, goal: Goal, tolerance: float, good_enough: float) -> Solution:
        """Find a motion from rest to rest that moves parts as asked, on the cycle map.

        Parameters
        ----------
        goal : Goal
            Start state and wanted displacements.
        tolerance : float
            Greatest error at which to stop [m].
        good_enough : float
            Root mean square error [m] above which other starts are tried.

        Returns
        -------
        Solution
            `residual` is the displacement error in mu m g: error / (mu g T^2).
        """

    @abstractmethod
    def steering_period(self, count: int) -> float:
        """Period [s] of the cycles that `steer` makes for `count` parts."""
