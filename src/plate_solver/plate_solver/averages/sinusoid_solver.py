"""Method B (section 3.2 of the paper) on the averaged map. The solver finds sums of sinusoids that
exert requested mean forces.

Requests without curls are solved in C++ (`sinusoids.invert`). For requests with curls, a motion is
sampled at equal time steps and fitted by the Levenberg-Marquardt method and basin hopping. The
input is a `Request`, and the output is a `Solution`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plate_core import PlateCycle, PlateError, Rig

from ..fit import Fit, basin_hopping, fit
from ..goal import Solution
from ..library import Library
from ..limits import within_limits
from ..motion_solver import check_options
from ..sinusoids.basis import SinusoidFamily, sinusoid_basis
from ..sinusoids.solver import HARMONIC_S, SinusoidCycles, SinusoidOptions
from .force_solver import ForceSolver
from .mean_force import step_force_gradient, step_forces
from .refinement import force_solution
from .request import Request
from .sinusoids import FEW_CANDIDATES, Motions, invert, motions_of
from .unreachable import is_out_of_reach

CURL_SAMPLES = 8192
"""Number of samples for the evaluation of curls. A curl is the mean of u3/slip, where u3 is the
angular velocity of the plate. Therefore, times at which the slip nearly vanishes have more
influence on a curl than on a force."""

SPREAD = 0.7
"""Size of the random perturbation of the best motion, as a fraction of a random motion. The
perturbation is used only for requests with curls."""

STARTS = 3
"""Number of starts of the search on the averaged map for each restart in the options. One start
takes a tenth of a millisecond."""

MAX_STARTS = 200
"""Maximum number of different random starts. If a search needs more starts, it uses the same starts
again."""


@dataclass(frozen=True)
class SinusoidForceOptions(SinusoidOptions):
    """Options of `SinusoidSolver`. The options are all options of `SinusoidOptions`, and those
    below.

    Attributes
    ----------
    at_rest : bool
        Whether cycles start and end with the plate at home and at rest. The condition of rest
        reduces the number of parameters by two per degree of freedom. The cycles of the method
        `steer` always satisfy it.
    tolerance : float
        Maximum force error that counts as success [mu m g].

    On the averaged map, the maximum number of further starts is `STARTS` times `restarts`.
    """

    at_rest: bool = False
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        check_options(self, tolerance=(0.0, 1.0))
        if self.at_rest and self.harmonics == 1:
            raise PlateError("harmonics is 1; at_rest requires 0 (automatic) or at least 2")


class SinusoidSolver(ForceSolver, SinusoidCycles):
    """Solver that finds sums of sinusoids with requested mean forces.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    **options
        Fields of `SinusoidForceOptions`.
    """

    kind = SinusoidForceOptions
    options: SinusoidForceOptions

    def __init__(self, rig: Rig, **options: float) -> None:
        super().__init__(rig, **options)
        self.library = Library.around(rig.plate.half)
        self._searches: dict[tuple[int, float, bool], tuple[Motions, np.ndarray]] = {}
        self._warm: dict[tuple[int, float, bool], np.ndarray] = {}

    def forget(self) -> None:
        super().forget()
        self._warm.clear()

    def harmonics(self, constraints: int) -> int:
        """Return the number of harmonics that is used for `constraints` requested force
        components."""
        return self._key(constraints)[0]

    def search_of(self, constraints: int) -> tuple[Motions, np.ndarray]:
        """Return the arguments `motions` and `pool` of `invert`, for `constraints` requested force
        components."""
        key = self._key(constraints)
        if key not in self._searches:
            basis = sinusoid_basis(*key)
            size = min(self.options.restarts + 1, MAX_STARTS) * FEW_CANDIDATES
            pool = np.random.default_rng(self._seed).normal(size=(size, 3 * basis.size))
            self._searches[key] = motions_of(key[0], basis, self._limits), pool
        return self._searches[key]

    def _key(self, constraints: int) -> tuple[int, float, bool]:
        """Return the number of harmonics, the period [s], and whether motions start at rest, for
        `constraints` requested force components."""
        if self.options.at_rest:
            return *self._rest_key(constraints), True
        # Motions of N harmonics can control 6 N - 2 independent force components.
        number = self.options.harmonics or max(2, -(-(2 * constraints + 4) // 6))
        return number, self.options.period or HARMONIC_S * number, False

    def _solve(self, request: Request) -> Solution:
        if request.flags.has_curl:
            return self._solve_with_curl(request)
        key = self._key(request.force.size)
        motions, pool = self.search_of(request.force.size)
        tolerance = self.options.tolerance
        warm = self._warm.get(key)
        found = invert(
            pool[:0] if warm is None else warm[None],
            pool,
            request.position,
            request.velocity,
            request.force,
            motions,
            tolerance,
            self.options.iterations,
            STARTS * self.options.restarts + 1,
        )
        self._warm[key] = found.theta
        cycle = PlateCycle(
            sinusoid_basis(*key).times, found.pose, found.twist, found.accel, found.spline
        )
        message = f"force error {found.worst:.2g} mu m g after {found.iterations} iterations"
        if found.worst <= tolerance:
            return Solution(True, message, cycle, found.error, found.iterations, found.condition)
        got = float(np.sum(request.force * (request.force - found.error)))
        fraction = got / max(float(np.sum(request.force**2)), 1e-300)
        return Solution(
            success=False,
            message=f"{message}, allowed: {tolerance:g}",
            cycle=cycle,
            residual=found.error,
            iterations=found.iterations,
            condition=found.condition,
            fraction=min(max(fraction, 0.0), 1.0),
        )

    def proven_out_of_reach(self, request: Request) -> bool:
        flags = request.flags
        if flags.parts_move or flags.has_tolerance or flags.has_curl:
            return False
        number = self.harmonics(request.force.size)
        return is_out_of_reach(request.position, request.force, number, self._limits.arm_m)

    def _solve_with_curl(self, request: Request) -> Solution:
        key = self._key(int(np.sum(request.rows)))
        basis, options = sinusoid_basis(*key), self.options
        family = SinusoidFamily(basis, self._limits)
        fine = SinusoidFamily(sinusoid_basis(*key, steps=CURL_SAMPLES), self._limits)
        tolerance, max_iterations = options.tolerance, options.iterations

        def attempt(start: np.ndarray, _: int) -> tuple[Fit, float, int, bool]:
            found = fit_curl(request, family, start, tolerance / 10, max_iterations)
            steps, good = found.iterations, np.max(np.abs(found.error)) <= tolerance
            # coarse samples can miss times at which the slip nearly vanishes: repeat with fine
            # samples
            if good:
                found = fit_curl(request, fine, found.parameters, tolerance / 10, max_iterations)
                steps, good = steps + found.iterations, np.max(np.abs(found.error)) <= tolerance
            return found, found.cost, steps, bool(good)

        def propose(_: int, near: Fit, fresh: bool) -> np.ndarray:
            start = family.random(self._rng)
            return start if fresh else near.parameters + SPREAD * start

        start = self._warm.get(key)
        begin = family.random(self._rng) if start is None else start
        best, iterations = basin_hopping(propose, attempt, begin, 1 + options.restarts)
        best = fit_curl(request, fine, best.parameters, tolerance / 10, max_iterations)
        self._warm[key] = best.parameters
        cycle = within_limits(family.cycle(best.parameters), self._full)
        t = (np.arange(CURL_SAMPLES) + 0.5) / CURL_SAMPLES * cycle.period
        error = curl_error(request, cycle.twist(t))
        return force_solution(
            request, error, cycle, tolerance, iterations + best.iterations, best.condition
        )


def curl_error(request: Request, twist: np.ndarray) -> np.ndarray:
    """Return the errors of the requested components (`Request.rows`) [mu m g]. The twists (n, 3) of
    the plate are sampled at equal time steps."""
    got = step_forces(request.position, request.velocity, twist, np.ones(len(twist))).ravel()
    return np.asarray(((request.requested - got) * request.scale)[request.rows])


def fit_curl(
    request: Request, family: SinusoidFamily, start: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Adjust a motion until its average forces and curls match the request, equations (5) and (12).

    The errors of the requested components (`Request.rows`) have the unit mu m g. The search stops
    when the largest error is at most `tolerance`.
    """
    rows, scale = request.rows, request.scale[request.rows]

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        _, twist, dt = family.samples(theta)

        def slopes() -> np.ndarray:
            gradient = step_force_gradient(request.position, request.velocity, twist, dt)
            return scale[:, None] * family.pull_back(gradient)[rows]

        return curl_error(request, twist), slopes

    return fit(evaluate, family.admissible, start, tolerance, iterations)
