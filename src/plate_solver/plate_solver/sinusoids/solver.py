"""Method B (section 3.2 of the paper) on the cycle map: cycles that are sums of sinusoids.

`SinusoidCycles` selects the number of harmonics and the period for a goal. Then the solver runs the
search of `SinusoidSteering` and returns a `Solution`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from plate_core import Rig

from ..goal import Goal, Solution, goal_solution
from ..motion_solver import MotionSolver, check_options, make_options
from .steer import SinusoidSteering

HARMONIC_S = 0.025
"""Length of a cycle per harmonic [s]. This length is used if the number of harmonics is set by an
option."""

EXACT_CYCLES = (8, 8, 0.1), (16, 8, 0.15), (24, 12, 0.3), (math.inf, 16, 0.4)
"""Cycles from rest to rest for force requests. The forces of such cycles have rank 6 N - 7. Each
entry contains the maximum number of requested coordinates, the number of harmonics N, and the
period [s]. The values were tuned in closed loop. Few harmonics make the search fast, short cycles
correct friction errors early, and long cycles use the stroke."""

LASTING_CYCLES = (4, 4, 0.1), (8, 6, 0.15), (math.inf, 8, 0.2)
"""Cycles from rest to rest for goals with targets, which several cycles may complete. The entries
have the same form as in `EXACT_CYCLES`."""

GOING_ON = (15.0, 8, 0.2), (math.inf, 8, 0.1)
"""Cycles with a free end. Each entry contains the maximum shaking ratio Gamma, the number of
harmonics and the period [s]. The values were tuned in closed loop. If the shaking ratio is low,
long cycles move parts farther."""


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
        self._steering = SinusoidSteering(
            self._limits,
            self._full,
            self.options.iterations,
            self.options.restarts,
            self.options.threads,
        )

    def forget(self) -> None:
        self._steering.forget()

    def steer(
        self, goal: Goal, tolerance: float, good_enough: float, until: float = math.inf
    ) -> Solution:
        number, period = self._steering_key(goal.requested_count, goal.lasting, goal.free_end)
        cycle, iterations, condition = self._steering.steer(
            goal, number, period, tolerance, good_enough, self._rng, until
        )
        self.cut_short = self._steering.cut_short
        return goal_solution(goal, cycle, good_enough, iterations, condition)

    def steering_period(
        self, count: int, turns: int = 0, lasting: bool = False, free_end: bool = False
    ) -> float:
        return self._steering_key(2 * count + turns, lasting, free_end)[1]

    def _steering_key(self, constraints: int, lasting: bool, free_end: bool) -> tuple[int, float]:
        """Return the number of harmonics and the period [s] of the cycles of `steer`."""
        if lasting and free_end and not self.options.harmonics:
            return next((n, s) for max_gamma, n, s in GOING_ON if self._gamma <= max_gamma)
        return self._rest_key(constraints, lasting)

    def _rest_key(self, constraints: int, lasting: bool = False) -> tuple[int, float]:
        """Return the number of harmonics and the period [s] of cycles from rest to rest."""
        number = self.options.harmonics
        if number:
            number, period = max(number, 2), max(HARMONIC_S * number, 0.1)
        else:
            table = LASTING_CYCLES if lasting else EXACT_CYCLES
            number, period = next((n, s) for max_count, n, s in table if constraints <= max_count)
        return number, self.options.period or period
