"""Method B (section 3.2 of the paper) on the cycle map: cycles that are sums of sinusoids.

`SinusoidCycles` selects the number of harmonics and the period for a goal, and searches from
several starts. The first descent starts from the last motion. All other descents start from random
perturbations of the best result. A play is one execution of a motion. Each play begins in the state
in which the previous play ends. A motion with a free end is evaluated by the state of the parts
after `PLAYS` plays:

    minimise J(x_PLAYS) over a,    x_{k+1} = F(x_k, p_k; a),    p_{k+1} = E a,

Here x_k is the state of the parts, p_k is the state of the plate, and a are the coefficients of
`SinusoidBasis`. Only the first play becomes the cycle. The next result of the solver replaces the
second play. If only one play were evaluated, the search would not consider whether the final state
of the plate is suitable for the next cycle. Sorting tasks would then take longer.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from plate_core import Rig

from ..cycle_map import PREDICTION_STEP
from ..fit import Fit
from ..goal import Goal, Solution, goal_solution
from ..limits import Limits, within_limits
from ..motion_solver import MotionSolver, check_options, make_options
from .basis import (
    KNOTS_PER_HARMONIC,
    MAX_STEP,
    STEPS_PER_HARMONIC,
    SinusoidFamily,
    sinusoid_basis,
)
from .descent import BIN, Motions, Problem, descend

HARMONIC_S = 0.025
"""Length of a cycle per harmonic [s]. This length is used if the number of harmonics is set by an
option."""

FORCE_CYCLES = (8, 8, 0.1), (16, 8, 0.15), (24, 12, 0.3), (math.inf, 16, 0.4)
"""Cycles from rest to rest for force requests. The forces of such cycles have rank 6 N - 7. Each
entry contains the maximum number of requested coordinates, the number of harmonics N, and the
period [s]. The values were tuned in closed loop. Few harmonics make the search fast, short cycles
correct friction errors early, and long cycles use the stroke."""

TARGET_CYCLES = (4, 4, 0.1), (8, 6, 0.15), (math.inf, 8, 0.2)
"""Cycles from rest to rest for goals with targets, which several cycles may complete. The entries
have the same form as in `FORCE_CYCLES`."""

FREE_END_CYCLES = (15.0, 8, 0.2), (math.inf, 8, 0.1)
"""Cycles with a free end. Each entry contains the maximum shaking ratio Gamma, the number of
harmonics and the period [s]. The values were tuned in closed loop. If the shaking ratio is low,
long cycles move parts farther."""

Grid = tuple[float, int, int]
"""Maximum time step of a motion during a search [s], minimum number of time steps per period of the
highest harmonic, and number of knots of the finished cycle per period of this harmonic."""

EXACT: Grid = (MAX_STEP, STEPS_PER_HARMONIC, KNOTS_PER_HARMONIC)
"""Grid for force requests. The `FINAL_CORRECTIONS` compensate the error of the grid."""

ROUGH: Grid = (0.8e-3, 16, 5)
"""Grid for goals that several cycles may complete. This grid has fewer knots than `EXACT`, so that
the cycle is transmitted faster."""

FINE: Grid = (PREDICTION_STEP, 1, 5)
"""Grid on which the finished motion is evaluated."""

DESCENT_USE, FINAL_USE = 1.3, 1.0
"""Maximum utilisation of the search's limits during the descents from all starts, and in the final
corrections. limits.py explains all such fractions."""

RANDOM_STARTS = 3
"""Number of additional random starts. Random starts are used if there is no last motion."""

AT_ONCE = 4
"""Number of descents that run at the same time. A new descent starts near the best result of all
finished descents. This number does not depend on the number of threads, so that a seed always gives
the same motions."""

SPREAD = 0.15
"""Root mean square of a perturbation, divided by the root mean square of the best motion's
parameters."""

PLAYS = 2
"""Number of consecutive plays after which a motion with a free end is evaluated. A third play
brings no improvement: see docs/results.md."""

FORCE_LOOKAHEAD_S = 0.01
"""Time by which the search extrapolates the parts if forces are requested [s] (`Goal.ahead`). The
final corrections remove the error of the displacements that the extrapolation causes. Without the
extrapolation, a fast part often ends a cycle too slowly, and the next cycle cannot reach its
displacement. The extrapolation makes goals with moving parts that must stop more difficult. In a
test of 800 such searches with 1 to 10 parts, 58 % had an error below `DRIFT_TOLERANCE`. Without the
extrapolation, 67 % of the searches had such an error."""

FINAL_CORRECTIONS = 2
"""Number of final corrections of the best motion. The corrections keep the limits and compensate
the difference between fine and coarse steps."""

CORRECTION_ITERATIONS = 8
"""Maximum number of iterations of each final correction."""


@dataclass(frozen=True)
class SinusoidOptions:
    """Options of `SinusoidCycles`.

    Attributes
    ----------
    harmonics : int
        Number of harmonics N of equation (13). If 0, the number of requested coordinates determines
        N.
    period : float
        Length of the cycle [s]. If 0, the number of harmonics determines the length.
    iterations : int
        Maximum number of iterations from one start.
    restarts : int
        Maximum number of further starts if the first one fails. A motion with a free end uses half
        of this number, because two plays are evaluated.
    threads : int
        Number of threads of `steer`. The number does not change the results.
    seed : int
        Random seed of the further starts.
    """

    harmonics: int = 0
    period: float = 0.0
    iterations: int = 40
    restarts: int = 100
    threads: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(
            self,
            harmonics=(0, 64),
            period=(0.0, 10.0),
            iterations=(1, 10_000),
            restarts=(0, 10_000),
            threads=(1, 1024),
            seed=(0, 2**31 - 1),
        )


class SinusoidCycles(MotionSolver):
    """Solver that moves parts to a goal by cycles of sinusoids.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    **options
        Fields of `SinusoidOptions`.
    """

    kind = SinusoidOptions

    def __init__(self, rig: Rig, **options: float) -> None:
        self.options: SinusoidOptions = make_options(self.kind, options)
        super().__init__(rig, self.options.seed)
        self._gamma = rig.gamma
        threads = min(self.options.threads, AT_ONCE)
        self._threads = ThreadPoolExecutor(threads) if threads > 1 else None
        self._finishing = 0.0  # computing time of the final corrections in the previous search [s]
        # Twists of the last motion for each combination of number of harmonics, period, grid and
        # `free_end`.
        self._last_twist: dict[tuple[int, float, Grid, bool], np.ndarray] = {}
        self._motions: dict[tuple[int, float, Grid, bool], Motions] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a copy or a pickle. The copy creates its own kernel objects."""
        return vars(self) | {"_motions": {}}

    def forget(self) -> None:
        self._last_twist.clear()

    def steering_period(
        self, count: int, rotating_parts: int = 0, multi_cycle: bool = False, free_end: bool = False
    ) -> float:
        return self._steering_key(2 * count + rotating_parts, multi_cycle, free_end)[1]

    def _steering_key(
        self, constraints: int, multi_cycle: bool, free_end: bool
    ) -> tuple[int, float]:
        """Return the number of harmonics and the period [s] of the cycles of `steer`."""
        if multi_cycle and free_end and not self.options.harmonics:
            return next((n, s) for max_gamma, n, s in FREE_END_CYCLES if self._gamma <= max_gamma)
        return self._rest_key(constraints, multi_cycle)

    def _rest_key(self, constraints: int, multi_cycle: bool = False) -> tuple[int, float]:
        """Return the number of harmonics and the period [s] of cycles from rest to rest."""
        number = self.options.harmonics
        if number:
            number, period = max(number, 2), max(HARMONIC_S * number, 0.1)
        else:
            table = TARGET_CYCLES if multi_cycle else FORCE_CYCLES
            number, period = next((n, s) for max_count, n, s in table if constraints <= max_count)
        return number, self.options.period or period

    def steer(
        self, goal: Goal, tolerance: float, good_enough: float, until: float = math.inf
    ) -> Solution:
        """Find a motion, as described in `MotionSolver.steer`.

        The first descent starts from the last motion. If there is no last motion, the first
        descents start from random motions. All other descents start from perturbations of the best
        result. The search ends when the root mean square error is at most `good_enough` [m], when
        all starts are used, or when a further descent would exceed the deadline.
        """
        number, period = self._steering_key(goal.requested_count, goal.multi_cycle, goal.free_end)
        grid, plays = ROUGH if goal.multi_cycle else EXACT, PLAYS if goal.free_end else 1
        family, fine = (
            family_on_grid(number, period, self._limits, on_grid, goal.free_end, goal.plate, plays)
            for on_grid in (grid, FINE)
        )
        key = number, period, grid, goal.free_end
        if key not in self._motions:
            self._motions[key] = Motions.of(family.basis, self._limits)
        motions = self._motions[key]
        last_twist = self._last_twist.get(key)
        fresh = RANDOM_STARTS if last_twist is None else 0
        aim = goal if goal.multi_cycle else goal.ahead(FORCE_LOOKAHEAD_S, period)
        problem = Problem.of(aim, motions, DESCENT_USE)

        def start(index: int, near: Fit) -> np.ndarray:
            if index < fresh:
                return family.random(self._rng)
            parameters = near.parameters
            size = SPREAD * math.sqrt(parameters @ parameters / len(parameters))
            return parameters + size * self._rng.normal(size=len(parameters))

        def improved(start: np.ndarray) -> Fit:
            return descend(problem, start, tolerance, self.options.iterations)

        begin = family.random(self._rng) if last_twist is None else family.nearest(last_twist)
        enough = good_enough**2 * goal.requested_count
        max_starts = -(-self.options.restarts // plays) + fresh
        best, iterations = self._search(improved, start, begin, max_starts, enough, until)
        began = time.monotonic()
        final, more = corrected(goal, motions, family, fine, best.parameters, tolerance)
        self._last_twist[key] = family.samples(final.parameters)[1]
        jacobian = final.jacobian[: goal.rows]
        jacobian = jacobian[np.any(jacobian != 0, axis=1)]
        condition = final._replace(jacobian=jacobian).condition if len(jacobian) else 1.0
        self._finishing = time.monotonic() - began
        cycle = within_limits(
            family.cycle(final.parameters), self._full, lambda: family.cycle(0 * begin)
        )
        return goal_solution(goal, cycle, good_enough, iterations + more, condition)

    def _search(
        self,
        improved: Callable[[np.ndarray], Fit],
        start: Callable[[int, Fit], np.ndarray],
        begin: np.ndarray,
        max_starts: int,
        enough: float,
        until: float,
    ) -> tuple[Fit, int]:
        """Return the best result of all descents, and their total number of iterations."""
        began = time.monotonic()
        best = improved(begin)
        latest = until - self._finishing - (time.monotonic() - began)  # start of a descent
        iterations, index = best.iterations, 0
        running: deque[Callable[[], Fit | None]] = deque()

        def in_time(start: np.ndarray) -> Fit | None:
            return None if time.monotonic() > latest else improved(start)

        while best.cost > enough and (running or index < max_starts):
            while index < max_starts and len(running) < AT_ONCE:
                work = partial(in_time, start(index, best))
                running.append(self._threads.submit(work).result if self._threads else work)
                index += 1
            found = running.popleft()()
            if found is None:
                # The deadline has passed. Setting `max_starts` to 0 ends the search. `cut_short`
                # increases at most once per search.
                self.cut_short += max_starts > 0
                max_starts = 0
            else:
                iterations += found.iterations
                best = found if found.cost < best.cost else best
        return best, iterations


def corrected(
    goal: Goal, motions: Motions, family: SinusoidFamily, fine: SinusoidFamily,
    parameters: np.ndarray, tolerance: float,
) -> tuple[Fit, int]:  # fmt: skip
    """Improve a motion of `family` for a goal, and keep it within the limits. Then correct the
    motion `FINAL_CORRECTIONS` times, so that its end on the grid of `fine` agrees with the goal.
    Return the last fit, and the number of iterations of these corrections."""

    def improved(goal: Goal, start: np.ndarray) -> Fit:
        problem = Problem.of(goal, motions, FINAL_USE)
        return descend(problem, start, tolerance, CORRECTION_ITERATIONS)

    final, iterations = improved(goal, parameters), 0
    for _ in range(FINAL_CORRECTIONS):
        parameters_before = final.parameters
        off = goal.end(*fine.samples(parameters_before)) - goal.end(
            *family.samples(parameters_before)
        )
        final = improved(goal.shifted(-off), parameters_before)
        iterations += final.iterations
    return final, iterations


def family_on_grid(
    number: int, period: float, limits: Limits, grid: Grid = EXACT,
    free_end: bool = False, plate: np.ndarray | None = None, plays: int = 1,
) -> SinusoidFamily:  # fmt: skip
    """Return the family of motions that start in the plate state (3, 3). Default: at rest.

    The motions end at rest or, if `free_end`, in any state. `grid` is `EXACT`, `ROUGH` or `FINE`.
    The samples cover `plays` plays.
    """
    max_step, steps_per_harmonic, knots = grid
    count = max(steps_per_harmonic * max(number, 4), round(period / max_step))
    basis = sinusoid_basis(number, period, True, -(-count // BIN) * BIN, free_end, knots, plays)
    return SinusoidFamily(basis, limits, np.zeros((3, 3)) if plate is None else plate)
