"""Multi-start search for sinusoidal motions on the cycle map.

The first descent starts from the last motion. All other descents start from random perturbations of
the best result. A play is one execution of a motion. Each play begins in the state in which the
previous play ends. A motion with a free end is evaluated by the state of the parts after `PLAYS`
plays:

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
from functools import partial
from typing import Any

import numpy as np

from plate_core import PlateCycle

from ..cycle_map import PREDICTION_STEP
from ..fit import Fit
from ..goal import Goal
from ..limits import Limits, within_limits
from .basis import sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .limits import LimitedSinusoids

Grid = tuple[float, int, int]
"""Maximum time step of a motion during a search [s], minimum number of time steps per period of the
highest harmonic, and number of knots of the finished cycle per period of this harmonic."""

EXACT: Grid = (0.4e-3, 26, 8)
"""Grid for force requests. The friction model is integrated by first-order steps. Steps of 1 ms
would cause a drift error of 10 %. The final corrections (`AIMS`) compensate the error of the
grid."""

ROUGH: Grid = (0.8e-3, 16, 5)
"""Grid for goals that several cycles may complete. This grid has fewer knots than `EXACT`, so that
the cycle is transmitted faster."""

FINE: Grid = (PREDICTION_STEP, 1, 5)
"""Grid on which the finished motion is evaluated."""

BEYOND = 1.3
"""Largest permitted utilisation of any rig limit by a motion during the search (1: exactly at the
limit)."""

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

AIMS = 2
"""Number of final corrections of the best motion. The corrections keep the limits and compensate
the difference between fine and coarse steps."""

CORRECTIONS = 8
"""Maximum number of iterations of each final correction."""


class SinusoidSteering:
    """Search for sinusoidal motions. The last motion is a start for the next search.

    Parameters
    ----------
    limits, full : Limits
        Limits of the search, and limits of the finished motion.
    iterations : int
        Maximum number of iterations of a descent.
    restarts : int
        Maximum number of further descents. For motions that are evaluated after `PLAYS` plays, this
        number is divided by `PLAYS`, because each descent takes longer. If there is no last motion,
        the search makes up to `RANDOM_STARTS` additional descents.
    threads : int
        Number of threads, at most `AT_ONCE`.
    clock : callable
        Function that returns the time [s].

    Attributes
    ----------
    cut_short : int
        Number of searches that the deadline ended early.
    """

    def __init__(
        self,
        limits: Limits,
        full: Limits,
        iterations: int,
        restarts: int,
        threads: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limits, self._full = limits, full
        self._iterations, self._restarts = iterations, restarts
        self._threads = ThreadPoolExecutor(min(threads, AT_ONCE)) if threads > 1 else None
        self._clock = clock
        self.cut_short = 0
        self._finishing = 0.0  # computing time of the final corrections in the previous search [s]
        # Twists of the last motion for each combination of number of harmonics, period, grid and
        # `free_end`.
        self._warm: dict[tuple[int, float, Grid, bool], np.ndarray] = {}
        self._motions: dict[tuple[int, float, Grid, bool], Motions] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a copy or a pickle. The copy creates its own kernel objects."""
        return vars(self) | {"_motions": {}}

    def forget(self) -> None:
        """Forget the last motions."""
        self._warm.clear()

    def steer(
        self,
        goal: Goal,
        number: int,
        period: float,
        tolerance: float,
        good_enough: float,
        rng: np.random.Generator,
        until: float = math.inf,
    ) -> tuple[PlateCycle, int, float]:
        """Find a motion with `number` harmonics.

        Return the motion, the number of iterations of all descents, and the condition number of the
        displacements' derivatives.

        The first descent starts from the last motion. If there is no last motion, the first
        descents start from random motions. All other descents start from perturbations of the best
        result. The search ends when the root mean square error is at most `good_enough` [m], when
        all starts are used, or when a further descent would exceed the deadline `until` [s, time of
        the clock].
        """
        grid, plays = ROUGH if goal.lasting else EXACT, PLAYS if goal.free_end else 1
        key = number, period, grid, goal.free_end

        def family_of(max_use: float) -> LimitedSinusoids:
            return limited_sinusoids(*key[:2], self._limits, max_use, *key[2:], goal.plate, plays)

        family = family_of(BEYOND)
        if key not in self._motions:
            self._motions[key] = Motions.of(family.basis, self._limits)
        motions = self._motions[key]
        known = self._warm.get(key)
        fresh = RANDOM_STARTS if known is None else 0
        aim = goal if goal.lasting else goal.ahead(FORCE_LOOKAHEAD_S, period)
        problem = Problem.of(aim, motions, BEYOND)

        def start(index: int, near: Fit) -> np.ndarray:
            if index < fresh:
                return family.random(rng)
            own = near.parameters
            size = SPREAD * math.sqrt(own @ own / len(own))
            return own + size * rng.normal(size=len(own))

        def improved(start: np.ndarray) -> Fit:
            return descend(problem, start, tolerance, self._iterations)

        begin = family.random(rng) if known is None else family.nearest(known)
        enough, max_starts = (
            good_enough**2 * goal.requested_count,
            -(-self._restarts // plays) + fresh,
        )
        best, iterations = self._search(improved, start, begin, max_starts, enough, until)
        began = self._clock()
        last = self._within(goal, motions, best.parameters, tolerance)
        strict = family_of(1.0)
        fine = limited_sinusoids(*key[:2], self._limits, 1.0, FINE, *key[3:], goal.plate, plays)
        for _ in range(AIMS):
            own = last.parameters
            off = goal.end(*fine.samples(own)) - goal.end(*strict.samples(own))
            last = self._within(goal.shifted(-off), motions, last.parameters, tolerance)
            iterations += last.iterations
        self._warm[key] = strict.samples(last.parameters)[1]
        jacobian = last.jacobian[: goal.rows]
        jacobian = jacobian[np.any(jacobian != 0, axis=1)]
        condition = last._replace(jacobian=jacobian).condition if len(jacobian) else 1.0
        self._finishing = self._clock() - began
        cycle = within_limits(
            strict.cycle(last.parameters), self._full, lambda: strict.cycle(0 * begin)
        )
        return cycle, iterations, condition

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
        began = self._clock()
        best = improved(begin)
        last = until - self._finishing - (self._clock() - began)
        iterations, index = best.iterations, 0
        running: deque[Callable[[], Fit | None]] = deque()

        def in_time(start: np.ndarray) -> Fit | None:
            return None if self._clock() > last else improved(start)

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

    def _within(self, goal: Goal, motions: Motions, start: np.ndarray, tolerance: float) -> Fit:
        """Improve a motion for a goal, and keep it within the limits."""
        return descend(Problem.of(goal, motions, 1.0), start, tolerance, CORRECTIONS)


def limited_sinusoids(
    number: int, period: float, limits: Limits, max_use: float, grid: Grid = EXACT,
    free_end: bool = False, plate: np.ndarray | None = None, plays: int = 1,
) -> LimitedSinusoids:  # fmt: skip
    """Return the family of motions that start in the plate state (3, 3). Default: at rest.

    The motions end at rest or, if `free_end`, in any state. `grid` is `EXACT`, `ROUGH` or `FINE`.
    The samples cover `plays` plays.
    """
    max_step, min_checks, knots = grid
    count = max(min_checks * max(number, 4), round(period / max_step))
    basis = sinusoid_basis(number, period, True, -(-count // BIN) * BIN, free_end, knots, plays)
    return LimitedSinusoids(basis, limits, max_use, plate)
