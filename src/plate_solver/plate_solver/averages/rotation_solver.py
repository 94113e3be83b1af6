"""Method A (section 3.1 of the paper) on the averaged map. The solver finds rotations that exert
requested mean forces.

A linear programme plans the rotations. After that, the Levenberg-Marquardt method corrects the
durations and twists of the rotations until the mean forces match the request. Basin hopping
provides further starts. The input is a `Request`, and the output is a `Solution`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from plate_core import PlateCycle, Rig

from ..fit import basin_hopping
from ..goal import Solution
from ..limits import within_limits
from ..motion_solver import check_options
from ..rotations.family import RotationFamily
from ..rotations.solver import RotationCycles, RotationOptions, Start, Try
from .force_solver import ForceSolver
from .mean_force import average_force
from .partial import reachable_fraction
from .refinement import force_solution
from .request import Request
from .rotations import fit_mean_force, mean_force_error
from .tour import filled, nearest_order

COARSE = (20, 4)
"""Numbers of time steps in each ramp and in each hold of a sequence of rotations, during the
search. A ramp needs more steps than a hold, because the slip of a part may nearly vanish during a
ramp."""

FINE = (60, 20)
"""Numbers of time steps in each ramp and in each hold of a sequence of rotations, during the final
correction."""

FINEST = (600, 200)
"""Numbers of time steps in each ramp and in each hold of a sequence of rotations, for the
evaluation of curls."""


@dataclass(frozen=True)
class RotationForceOptions(RotationOptions):
    """Options of `RotationSolver`. The options are all options of `RotationOptions`, and
    `tolerance`.

    Attributes
    ----------
    tolerance : float
        Maximum force error that counts as success [mu m g].
    """

    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        check_options(self, tolerance=(0.0, 1.0))


class RotationSolver(ForceSolver, RotationCycles):
    """Solver that finds sequences of rotations with requested mean forces.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    **options
        Fields of `RotationForceOptions`.
    """

    kind = RotationForceOptions
    options: RotationForceOptions

    def __init__(self, rig: Rig, **options: float | str) -> None:
        super().__init__(rig, **options)
        self._last: tuple[np.ndarray, Start] | None = None

    def forget(self) -> None:
        super().forget()
        self._last = None

    def _solve(self, request: Request) -> Solution:
        options, tolerance = self.options, self.options.tolerance

        def attempt(start: Start, _: int) -> tuple[Try, float, int, bool]:
            found = fit_mean_force(request, *start, tolerance / 4, options.iterations)
            good = np.max(np.abs(found.error)) <= tolerance
            return Try(start.family, found), found.cost, found.iterations, bool(good)

        def planned(spread: bool) -> Start:
            plan = filled(self._plan(request.position, request.force, request.curl, spread))
            plan = plan.in_order(nearest_order(plan.twist, self._limits.half))
            family = RotationFamily(
                plan.twist, self._limits, options.period, options.speed, COARSE, within_stroke=True
            )
            return Start(family, family.parameters(plan.fraction))

        def propose(_: int, near: Try, fresh: bool) -> Start:
            return planned(spread=True) if fresh else self._shaken(near)

        last = self._last
        known = last is not None and np.array_equal(last[0], request.position)
        begin = last[1] if last is not None and known else planned(spread=False)
        best, iterations = basin_hopping(propose, attempt, begin, 1 + options.restarts)
        family, found = best
        self._last = request.position, Start(family, found.parameters)
        cycle, error = self._evaluated(request, family, found.parameters)
        # the time steps of the search missed a time at which the slip nearly vanishes
        if np.max(np.abs(error)) > tolerance:
            fine = family.with_steps(FINE)
            found = fit_mean_force(
                request, fine, found.parameters, tolerance / 10, options.iterations
            )
            iterations += found.iterations
            cycle, error = self._evaluated(request, fine, found.parameters)
        solution = force_solution(request, error, cycle, tolerance, iterations, found.condition)
        if solution.success or np.any(request.velocity):
            return solution
        fraction = reachable_fraction(self.library, request.position, request.force)
        if fraction >= 1:
            return solution
        return replace(
            solution, message=f"{solution.message}; a fraction of about {fraction:.2g} is possible"
        )

    def _evaluated(
        self, request: Request, family: RotationFamily, parameters: np.ndarray
    ) -> tuple[PlateCycle, np.ndarray]:
        """Return the motion within the limits of the rig, and the errors of the requested
        components (`Request.rows`) [mu m g]. The forces are evaluated with `average_force`. The
        curls are evaluated with the time steps `FINEST`."""
        cycle = within_limits(family.cycle(parameters), self._full)
        error = np.zeros(np.count_nonzero(request.rows))
        if np.any(np.isfinite(request.curl)):
            error = mean_force_error(request, family.with_steps(FINEST), parameters)
        true = request.force - average_force(cycle, request.position, request.velocity)
        error[np.flatnonzero(request.rows) % 3 < 2] = true.ravel()
        return cycle, error
