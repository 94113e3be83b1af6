"""What both methods have in common: the two problems that a solver solves."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from plate_core import PlateCycle, PlateError, Rig

from .averages.partial import easiest_force, largest_fraction
from .averages.refinement import (
    MOST_ON_CYCLE,
    REFINED_TOLERANCE,
    REFINEMENTS,
    judged,
    on_cycle,
    on_mean_velocity,
)
from .averages.request import Request
from .goal import Goal, Solution, Status
from .library import Library
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
        self._reach = Library.around(rig.plate.half)
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

    def solve(
        self,
        position: np.ndarray,
        force: np.ndarray,
        velocity: np.ndarray | None = None,
        curl: np.ndarray | None = None,
        *,
        tolerance: np.ndarray | None = None,
        refine: str = "none",
    ) -> Solution:
        """Find a closed motion with the wanted average forces, equations (5) and (9).

        What cannot be met is met in part: the largest fraction of the request that is found, in its
        direction; or, on refined maps, a motion that misses less of the whole than this fraction
        does. Where nothing is asked, the plate rests.

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
        tolerance : (M, 2), optional
            Slack [mu m g] by part and axis: any force within +- this of the one wanted is as good.
            Infinite where anything goes; zero if left out.
        refine : str
            The map on which forces are met, and by which `residual` judges them:
            `none`: (5) for parts that keep place and velocity;
            `velocity`: (5) for parts that keep place, and the velocity they have on average over
            the cycle under this very motion;
            `cycle`: the parts' stick-slip motion over one cycle of length T. The displacement less
            velocity times T is to be force times mu g T^2: the drift grows as the force would make
            it grow. Curls are not asked for.

        Returns
        -------
        Solution
            With `velocity` and `cycle` a request counts as met if at most 10 % of it are missed
            (root mean square over parts and axes).

        Raises
        ------
        PlateError
            If shapes are wrong, values not finite, or options unknown.
        """
        request = Request.check(position, force, velocity, curl, tolerance)
        if refine not in REFINEMENTS:
            raise PlateError(f"refine is {refine!r}, allowed: {', '.join(REFINEMENTS)}")
        if refine == "cycle":
            request = replace(request, curl=np.full(len(request.force), np.nan))
        own, most, attempt = self._map(refine)

        def nothing() -> Solution:
            rest = PlateCycle.rest(self.steering_period(len(request.force)))
            return Solution(True, "nothing is asked: the plate rests", rest, request.force, 0, 1.0)

        if request.idle:
            return nothing()
        exact = refine == "none"
        prove = self.proven_out_of_reach if exact else None
        return largest_fraction(request, self._reach, attempt, nothing, 3 * own, most, prove)

    def proven_out_of_reach(self, request: Request) -> bool:
        """Whether it is proven that no motion of this kind meets a request; not if in doubt."""
        return False

    def _map(self, refine: str) -> tuple[float, float, Callable[[Request], Solution]]:
        """Return tolerance and greatest force [mu m g] of a map, and who solves on it."""
        own, friction = self.options.tolerance, self._rig.friction.accel
        wide = max(own, REFINED_TOLERANCE)

        def at_mean_velocity(request: Request) -> Solution:
            return on_mean_velocity(request, self._on_average, friction, wide)

        def at_cycle(request: Request) -> Solution:
            period = self.steering_period(len(request.position))
            return on_cycle(request, self.steer, period, friction, wide)

        if refine == "none":
            return own, 1.0, self._on_average
        return (
            (wide, 1.0, at_mean_velocity)
            if refine == "velocity"
            else (wide, MOST_ON_CYCLE, at_cycle)
        )

    def _on_average(self, request: Request) -> Solution:
        if not request.flags.slack:
            return self._solve(request)
        aim = easiest_force(request, self._reach)
        found = self._solve(replace(request, force=aim))
        error = request.force - (aim - found.residual)
        if not found.success:  # others within the slack may be in reach
            found = replace(found, status=Status.FAILED)
        return judged(request, found, error, self.options.tolerance)

    @abstractmethod
    def _solve(self, request: Request) -> Solution:
        """Do as `solve`, for a request that is checked."""

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
