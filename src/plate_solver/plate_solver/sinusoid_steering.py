"""Sinusoids on the cycle map: search on coarse steps beyond the limits, then finely within them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from plate_core import PlateCycle

from .harmonics import STEPS_PER_HARMONIC, harmonics
from .least_squares import Fit
from .limited_family import LimitedSinusoids
from .solution import Bounds
from .steering import Goal, steer

COARSE_STEP, FINE_STEP = 0.4e-3, 0.2e-3
"""Longest steps [s] of the search and of the last corrections: friction acts by first-order steps,
which miss 10 % of a drift at 1 ms, and at 0.4 ms still 10 % of a small one."""

ROOM = 1.3
"""Share of the limits that the search may use on its way."""

CORRECTIONS = 6
"""Most steps of the fine fit."""

MANY = 12
"""Displacements wanted of six parts."""

SPREAD = 0.7
"""Size of a disturbance of what is known, over that of a random motion."""


class SinusoidSteering:
    """Steers parts by sinusoids from rest; remembers the last motion as a start for the next.

    Parameters
    ----------
    bounds : Bounds
    iterations : int
        Most steps of a search.
    restarts : int
        Most further starts with six parts or more; fewer get more, in the same time.
    """

    def __init__(self, bounds: Bounds, iterations: int, restarts: int) -> None:
        self._bounds = bounds
        self._iterations, self._restarts = iterations, restarts
        self._warm: dict[tuple[int, float], np.ndarray] = {}

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
    ) -> tuple[Fit, PlateCycle, float]:
        """Find a motion with `number` harmonics.

        Returns the fit with the iterations of all starts, the motion, and the condition number of
        the displacements' derivatives.

        The last solution is the first start; then come, in turns, disturbances of the best one and
        motions drawn at random, until one misses less than `good_enough` [m, root mean square].
        """
        loose = self._family(number, period, COARSE_STEP, ROOM)
        count = goal.rows

        def attempt(start: np.ndarray) -> Fit:
            return steer(goal, loose, loose.admissible(start), tolerance, self._iterations)

        start = self._warm.get((number, period))
        best = attempt(loose.random(rng) if start is None else start)
        iterations = best.iterations
        for turn in range(self._restarts * max(1, MANY // count)):
            missed = best.error[:count]
            if missed @ missed <= good_enough**2 * count:
                break
            start = loose.random(rng)
            if turn % 2 == 0:
                start = best.parameters + SPREAD * start
            other = attempt(start)
            iterations += other.iterations
            if other.cost < best.cost:
                best = other
        strict = self._family(number, period, FINE_STEP, 1.0)
        start = strict.admissible(best.parameters)
        last = steer(goal, strict, start, tolerance, min(CORRECTIONS, self._iterations))
        self._warm[number, period] = last.parameters
        return (
            replace(last, iterations=iterations + last.iterations),
            strict.cycle(last.parameters),
            replace(last, jacobian=last.jacobian[:count]).condition,
        )

    def _family(self, number: int, period: float, step: float, room: float) -> LimitedSinusoids:
        steps = max(STEPS_PER_HARMONIC * max(number, 4), round(period / step))
        return LimitedSinusoids(harmonics(number, period, True, steps), self._bounds, room)
