"""Sinusoids on the cycle map: descents from the last motion and from disturbances of the best.

A motion with a free end is evaluated where it leaves the parts after `PLAYS` plays, each of which
begins in the state in which the previous one ends:

    minimise J(x_PLAYS) over a,    x_{k+1} = F(x_k, p_k; a),    p_{k+1} = E a,

with the parts' state x_k, the plate's state p_k, and the coefficients a of `SinusoidBasis`. Only
the first play becomes the cycle, and the next answer replaces the second. If one play is evaluated,
the search ignores how well the plate can go on from its end, and sorting takes longer.
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
"""Longest step [s] of a search; per period of the highest harmonic, least steps, and knots of the
finished cycle."""

EXACT: Grid = (0.4e-3, 26, 8)
ROUGH: Grid = (0.8e-3, 16, 5)
"""Of exact drifts, and of progress: friction acts by first-order steps, which miss 10 % of a drift
at 1 ms; what they miss at the end is aimed at once more. Fewer knots are sooner sent."""

FINE: Grid = (PREDICTION_STEP, 1, 5)
"""Of the steps by which a motion is judged."""

BEYOND = 1.3
"""Fraction of the limits that the search may use on its way."""

FRESH = 3
"""Further motions drawn at random where a search knows of none to begin with."""

AT_ONCE = 4
"""Descents that may run at the same time: each starts near the best of all but those that run, on
however many cores, so that a seed gives the same motions."""

SPREAD = 0.15
"""Size of a disturbance of the best motion so far, over that of this motion."""

PLAYS = 2
"""Plays after which a motion with a free end is evaluated. Three gain no more: docs/results.md."""

AIMS, CORRECTIONS = 2, 8
"""Times that the best motion is corrected within the limits for what finer steps show, and most
steps of each."""


class SinusoidSteering:
    """Steers parts by sinusoids; remembers the last motion as a start for the next.

    Parameters
    ----------
    limits, full : Limits
        That a search keeps, and that the motion keeps.
    iterations : int
        Most steps of a descent.
    restarts : int
        Most further descents; `FRESH` more without a motion to begin with. With `PLAYS` plays each
        descent takes longer, and so many times fewer are made.
    threads : int
        Cores that they may use, at most `AT_ONCE`.
    clock : callable
        Time [s].

    Attributes
    ----------
    cut_short : int
        Searches that the deadline has ended.
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
        self._finishing = 0.0  # how long the last answer took after its search [s]
        self._warm: dict[tuple[int, float, Grid, bool], np.ndarray] = {}  # twists
        self._motions: dict[tuple[int, float, Grid, bool], Motions] = {}

    def __getstate__(self) -> dict[str, Any]:
        """What a copy has: what kernels keep it makes anew."""
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

        Returns the motion, the iterations of all descents, and the condition number of the
        displacements' derivatives.

        Descents begin at the last solution, or else at some motions drawn at random, and then at
        disturbances of the best so far, until one misses less than `good_enough` [m, root mean
        square], or an answer by `until`, a time of the clock, allows no further one.
        """
        grid, plays = ROUGH if goal.lasting else EXACT, PLAYS if goal.free_end else 1
        key = number, period, grid, goal.free_end

        def family_of(most: float) -> LimitedSinusoids:
            return limited_sinusoids(*key[:2], self._limits, most, *key[2:], goal.plate, plays)

        family = family_of(BEYOND)
        if key not in self._motions:
            self._motions[key] = Motions.of(family.basis, self._limits)
        motions = self._motions[key]
        known = self._warm.get(key)
        fresh = FRESH if known is None else 0
        problem = Problem.of(goal, motions, BEYOND)

        def start(index: int, near: Fit) -> np.ndarray:
            if index < fresh:
                return family.random(rng)
            own = near.parameters
            size = SPREAD * math.sqrt(own @ own / len(own))
            return own + size * rng.normal(size=len(own))

        def improved(start: np.ndarray) -> Fit:
            return descend(problem, start, tolerance, self._iterations)

        begin = family.random(rng) if known is None else family.nearest(known)
        enough, most = good_enough**2 * goal.asked, -(-self._restarts // plays) + fresh
        best, iterations = self._search(improved, start, begin, most, enough, until)
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
        asked = last.jacobian[: goal.rows]
        asked = asked[np.any(asked != 0, axis=1)]
        condition = last._replace(jacobian=asked).condition if len(asked) else 1.0
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
        most: int,
        enough: float,
        until: float,
    ) -> tuple[Fit, int]:
        """Return the best of all descents, and their iterations."""
        began = self._clock()
        best = improved(begin)
        last = until - self._finishing - (self._clock() - began)
        iterations, index = best.iterations, 0
        running: deque[Callable[[], Fit | None]] = deque()

        def in_time(start: np.ndarray) -> Fit | None:
            return None if self._clock() > last else improved(start)

        while best.cost > enough and (running or index < most):
            while index < most and len(running) < AT_ONCE:
                work = partial(in_time, start(index, best))
                running.append(self._threads.submit(work).result if self._threads else work)
                index += 1
            found = running.popleft()()
            if found is None:
                self.cut_short += most > 0  # once
                most = 0
            else:
                iterations += found.iterations
                best = found if found.cost < best.cost else best
        return best, iterations

    def _within(self, goal: Goal, motions: Motions, start: np.ndarray, tolerance: float) -> Fit:
        """Correct a motion within the limits."""
        return descend(Problem.of(goal, motions, 1.0), start, tolerance, CORRECTIONS)


def limited_sinusoids(
    number: int, period: float, limits: Limits, most: float, grid: Grid = EXACT,
    free_end: bool = False, plate: np.ndarray | None = None, plays: int = 1,
) -> LimitedSinusoids:  # fmt: skip
    """Return the family that starts in a state of the plate (3, 3), at rest if left out, and ends
    at rest or, with `free_end`, in any state; grid is `EXACT` or `ROUGH`. Samples are of `plays`
    plays."""
    longest, least, knots = grid
    count = max(least * max(number, 4), round(period / longest))
    basis = sinusoid_basis(number, period, True, -(-count // BIN) * BIN, free_end, knots, plays)
    return LimitedSinusoids(basis, limits, most, plate)
