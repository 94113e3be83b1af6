"""Base class of the solvers for requested mean forces. Methods A and B both use it.

`ForceSolver.solve` checks a request and searches for a motion on one of three force maps (`none`,
`velocity` or `cycle`). If no motion for the request is found, `ForceSolver.solve` searches for the
largest feasible fraction of the request. Subclasses implement the search on the force map `none`.
"""

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
    MAX_ON_CYCLE,
    REFINED_TOLERANCE,
    REFINEMENTS,
    evaluated,
    on_cycle,
    on_mean_velocity,
)
from .request import Request


class ForceSolver(MotionSolver):
    """Solver that finds closed plate motions with requested average forces. The solver also has the
    method `steer` for goals on the cycle map.

    Attributes
    ----------
    library : Library
        Library of rotations, from which bounds of the feasible forces are computed.
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
        """Find a closed motion with the requested average forces, equations (5) and (9).

        If the solver finds no motion for the request, it returns a motion for the largest fraction
        of the request that it finds feasible. There is one exception on the maps `velocity` and
        `cycle`. If the motion for the whole request has a smaller error, the solver returns this
        motion. If zero force is requested, the plate rests.

        Parameters
        ----------
        position : (M, 2)
            Positions of the parts [m], plate_home.
        force : (M, 2)
            Requested average forces [mu m g].
        velocity : (M, 2), optional
            Velocities of the parts [m/s]. Default: 0.
        curl : (M,), optional
            Requested curl of the averaged field [mu m g / m]; NaN accepts any curl.
        tolerance : (M, 2), optional
            Tolerance of the force for each part and axis [mu m g]. Force errors within +-tolerance
            count as 0. Infinity accepts any force. Default: 0.
        refine : str
            Force map for the search and for `residual`:
            `none`: (5) for parts with constant position and velocity;
            `velocity`: (5) for parts with constant position, and with the mean velocity that they
            have over the cycle under the returned motion;
            `cycle`: the parts' stick-slip motion over one cycle of length T. The displacement minus
            velocity times T must be force times mu g T^2. Curls are ignored.

        Returns
        -------
        Solution
            On the maps `velocity` and `cycle`, a request counts as met if the error is at most 10 %
            of the request (root mean square over parts and axes).

        Raises
        ------
        PlateError
            If a shape is wrong, a value is not finite, or an option is unknown.
        """
        request = Request.check(position, force, velocity, curl, tolerance)
        if refine not in REFINEMENTS:
            raise PlateError(f"refine is {refine!r}, allowed: {', '.join(REFINEMENTS)}")
        if refine == "cycle":
            request = replace(request, curl=np.full(len(request.force), np.nan))
        error, max_force, attempt = self._map(refine)

        def nothing() -> Solution:
            rest = PlateCycle.rest(self.steering_period(len(request.force)))
            return Solution(
                True, "no force is requested: the plate rests", rest, request.force, 0, 1.0
            )

        if request.idle:
            return nothing()
        exact = refine == "none"
        prove = self.proven_out_of_reach if exact else None
        return largest_fraction(
            request, self.library, attempt, nothing, 3 * error, max_force, prove
        )

    def proven_out_of_reach(self, request: Request) -> bool:
        """Whether it is proven that no motion of this method meets a request. False means only that
        no proof was found."""
        return False

    def _map(self, refine: str) -> tuple[float, float, Callable[[Request], Solution]]:
        """Return three properties of the force map `refine`. The properties are the tolerance [mu m
        g], the maximum force [mu m g], and the function that solves a request on this map."""
        tolerance, friction = self.options.tolerance, self._rig.friction.accel
        wide = max(tolerance, REFINED_TOLERANCE)

        def at_mean_velocity(request: Request) -> Solution:
            return on_mean_velocity(request, self._on_average, friction, wide)

        def at_cycle(request: Request) -> Solution:
            period = self.steering_period(len(request.position))
            return on_cycle(request, self.steer, period, friction, wide)

        if refine == "none":
            return tolerance, 1.0, self._on_average
        return (
            (wide, 1.0, at_mean_velocity)
            if refine == "velocity"
            else (wide, MAX_ON_CYCLE, at_cycle)
        )

    def _on_average(self, request: Request) -> Solution:
        if not request.flags.has_tolerance:
            return self._solve(request)
        aim = easiest_force(request, self.library)
        found = self._solve(replace(request, force=aim))
        error = request.force - (aim - found.residual)
        # A failure for the force `aim` does not prove that the request is infeasible: other forces
        # within the tolerance may be feasible.
        if not found.success:
            found = replace(found, status=Status.FAILED)
        return evaluated(request, found, error, self.options.tolerance)

    @abstractmethod
    def _solve(self, request: Request) -> Solution:
        """Solve a checked request on the force map `none`. The tolerances of the request are 0."""
