"""Sinusoids on the cycle map: descents from the last motion and from disturbances of the best."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from plate_core import PlateCycle

from ..fit import Fit
from ..limits import Limits
from ..maps import finely_sampled
from ..requests import Goal
from .basis import STEPS_PER_HARMONIC, sinusoid_basis
from .descent import BIN, Motions, Problem, descend
from .limits import LimitedSinusoids

STEP, ROUGH_STEP = 0.4e-3, 0.8e-3
"""Longest step of a search for exact drifts, and for progress [s]: friction acts by first-order
steps, which miss 10 % of a drift at 1 ms; what they miss at the end is aimed at once more."""

BEYOND = 1.3
"""Fraction of the limits that the search may use on its way."""

FRESH = 3
"""Further motions drawn at random where a search knows of none to begin with."""

CROWD = 10
"""Parts; with more of them further descents gain more."""

SPREAD = 0.15
"""Size of a disturbance of the best motion so far, over that of this motion."""

AIMS, CORRECTIONS = 2, 8
"""Times that the best motion is corrected within the limits for what finer steps show, and most
steps of each."""

Descend = Callable[[Goal, np.ndarray, float, int], Fit]


class SinusoidSteering:
    """Steers parts by sinusoids from rest; remembers the last motion as a start for the next.

    Parameters
    ----------
    limits : Limits
    iterations : int
        Most steps of a descent.
    restarts : int
        Most further descents; `FRESH` more without a motion to begin with, and in proportion more
        for the progress of over `CROWD` parts.
    deadline : float
        Part of a cycle after which no further descent begins, by the clock; 0: none, so that a
        seed gives the same motions on any computer.
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
        iterations: int,
        restarts: int,
        deadline: float = 0.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limits = limits
        self._iterations, self._restarts = iterations, restarts
        self._deadline, self._clock = deadline, clock
        self.cut_short = 0
        self._warm: dict[tuple[int, float], np.ndarray] = {}
        self._motions: dict[tuple[int, float, float], Motions] = {}

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
    ) -> tuple[PlateCycle, int, float]:
        """Find a motion with `number` harmonics.

        Returns the motion, the iterations of all descents, and the condition number of the
        displacements' derivatives.

        Descents begin at the last solution, or else at some motions drawn at random, and then at
        disturbances of the best so far, until one misses less than `good_enough` [m, root mean
        square].
        """
        until = self._clock() + self._deadline * period if self._deadline else math.inf
        step = ROUGH_STEP if goal.lasting else STEP
        family = limited_sinusoids(number, period, self._limits, BEYOND, step)
        to = self._descend(number, period, step, tolerance)
        known, enough = self._warm.get((number, period)), good_enough**2 * goal.asked
        start = family.random(rng) if known is None else known
        best = to(goal, start, BEYOND, self._iterations)
        iterations = best.iterations
        crowd = max(1.0, len(goal.position) / CROWD) if goal.lasting else 1.0
        for index in range(round(crowd * self._restarts) + (FRESH if known is None else 0)):
            if best.cost <= enough:
                break
            if until < math.inf and self._clock() > until:
                self.cut_short += 1
                break
            if known is None and index < FRESH:
                start = family.random(rng)
            else:
                size = SPREAD * np.sqrt(np.mean(best.parameters**2))
                start = best.parameters + size * rng.normal(size=len(best.parameters))
            found = to(goal, start, BEYOND, self._iterations)
            iterations += found.iterations
            best = found if found.cost < best.cost else best
        last = to(goal, best.parameters, 1.0, CORRECTIONS)
        strict = limited_sinusoids(number, period, self._limits, 1.0, step)
        aim = goal
        for _ in range(AIMS):
            fine = goal.end(*finely_sampled(strict.cycle(last.parameters)))
            off = fine - goal.end(*strict.samples(last.parameters))
            aim = goal.shifted(-off)
            last = to(aim, last.parameters, 1.0, CORRECTIONS)
            iterations += last.iterations
        self._warm[number, period] = last.parameters
        asked = last.jacobian[: goal.rows]
        asked = asked[np.any(asked != 0, axis=1)]
        condition = last._replace(jacobian=asked).condition if len(asked) else 1.0
        return strict.cycle(last.parameters), iterations, condition

    def _descend(self, number: int, period: float, step: float, tolerance: float) -> Descend:
        """Return what improves a motion."""
        key = number, period, step
        if key not in self._motions:
            basis = limited_sinusoids(number, period, self._limits, 1.0, step).basis
            self._motions[key] = Motions.of(basis, self._limits)
        motions = self._motions[key]
        return lambda aim, start, most, iterations: descend(
            Problem.of(aim, motions, most), start, tolerance, iterations
        )


def limited_sinusoids(
    number: int, period: float, limits: Limits, most: float, step: float = STEP
) -> LimitedSinusoids:
    """Return the family that starts and ends at rest, in steps of at most `step` [s]."""
    steps = max(STEPS_PER_HARMONIC * max(number, 4), round(period / step))
    steps = -(-steps // BIN) * BIN
    return LimitedSinusoids(sinusoid_basis(number, period, True, steps), limits, most)
