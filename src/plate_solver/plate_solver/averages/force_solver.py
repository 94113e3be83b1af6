"""Motions for wanted mean forces: what a solver by either method does beside its search."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from plate_core import PlateCycle, PlateError

from ..goal import Solution, Status
from ..library import Library
from ..motion_solver import MotionSolver
from .partial import easiest_force, largest_fraction
from .refinement import (
    MOST_ON_CYCLE,
    REFINED_TOLERANCE,
    REFINEMENTS,
    judged,
    on_cycle,
    on_mean_velocity,
)
from .request import Request


class ForceSolver(MotionSolver):
    """Finds closed plate motions with wanted average forces; it can steer, too.

    Attributes
    ----------
    library : Library
        Rotations that bound what is in reach.
    """

    library: Library

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
        return largest_fraction(request, self.library, attempt, nothing, 3 * own, most, prove)

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
        aim = easiest_force(request, self.library)
        found = self._solve(replace(request, force=aim))
        error = request.force - (aim - found.residual)
        if not found.success:  # others within the slack may be in reach
            found = replace(found, status=Status.FAILED)
        return judged(request, found, error, self.options.tolerance)

    @abstractmethod
    def _solve(self, request: Request) -> Solution:
        """Do as `solve`, for a request that is checked."""
