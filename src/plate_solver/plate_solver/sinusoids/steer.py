"""Sinusoids on the cycle map: search on coarse steps beyond the limits, then finely within them."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

from ..fit import Fit, basin_hopping
from ..limits import Limits
from ..requests import Goal, fit_goal
from .basis import STEPS_PER_HARMONIC, sinusoid_basis
from .limits import LimitedSinusoids

COARSE_STEP, FINE_STEP = 0.4e-3, 0.2e-3
"""Longest steps [s] of the search and of the last corrections: friction acts by first-order steps,
which miss 10 % of a drift at 1 ms, and at 0.4 ms still 10 % of a small one."""

BEYOND = 1.3
"""Fraction of the limits that the search may use on its way."""

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
    limits : Limits
    iterations : int
        Most steps of a search.
    restarts : int
        Most further starts with six parts or more; fewer get more, in the same time.
    """

    def __init__(self, limits: Limits, iterations: int, restarts: int) -> None:
        self._limits = limits
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
    ) -> tuple[PlateCycle, int, float]:
        """Find a motion with `number` harmonics.

        Returns the motion, the iterations of all starts, and the condition number of the
        displacements' derivatives.

        The last solution is the first start; then come, in turns, disturbances of the best one and
        motions drawn at random, until one misses less than `good_enough` [m, root mean square].
        """
        loose, count = (
            limited_sinusoids(number, period, COARSE_STEP, self._limits, BEYOND),
            goal.rows,
        )

        def attempt(
            _: None, start: np.ndarray, __: int, ___: float
        ) -> tuple[Fit, float, int, bool]:
            found = fit_goal(goal, loose, start, tolerance, self._iterations)
            missed = found.error[:count]
            return found, found.cost, found.iterations, missed @ missed <= good_enough**2 * count

        def propose(_: None, __: int, near: Fit, fresh: bool) -> np.ndarray:
            start = loose.random(rng)
            return start if fresh else near.parameters + SPREAD * start

        start = self._warm.get((number, period))
        tries = 1 + self._restarts * max(1, MANY // count)
        begin = loose.random(rng) if start is None else start
        best, iterations, _ = basin_hopping(propose, attempt)(None, begin, tries, 1, False, 0)
        strict = limited_sinusoids(number, period, FINE_STEP, self._limits, 1.0)
        most = min(CORRECTIONS, self._iterations)
        last = fit_goal(goal, strict, best.parameters, tolerance, most)
        self._warm[number, period] = last.parameters
        condition = last._replace(jacobian=last.jacobian[:count]).condition
        return strict.cycle(last.parameters), iterations + last.iterations, condition


def limited_sinusoids(
    number: int, period: float, step: float, limits: Limits, most: float
) -> LimitedSinusoids:
    """Return the family that starts and ends at rest, in steps of at most `step` [s]."""
    steps = max(STEPS_PER_HARMONIC * max(number, 4), round(period / step))
    return LimitedSinusoids(sinusoid_basis(number, period, True, steps), limits, most)
