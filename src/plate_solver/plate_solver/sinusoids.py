"""Method B: sinusoidal motions (section 3.2 of the paper), on the averaged and on the cycle map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plate_core import PlateCycle, PlateError, Rig

from .averaged import fit_force, fit_force_finely, force_solution
from .guesses import GuessTable, guess_table
from .harmonic_fit import Motions, Waves
from .harmonic_force import rules
from .harmonic_search import FEW_CANDIDATES, Found, meet
from .harmonics import harmonics
from .least_squares import Fit
from .packed import Finish, Packed, packed
from .proof import is_out_of_reach
from .sinusoid_family import SinusoidFamily
from .sinusoid_steering import SinusoidSteering
from .solution import MARGIN, Request, Solution, check_options, within_limits
from .solver import MotionSolver, make_options
from .steering import Goal, steering_solution

CURL_SAMPLES = 8192
"""Samples on which curls are judged: their average, of u3/|slip|, feels dips more than a force."""

STARTS = 3
"""Starts of the compiled search for each restart: one takes a tenth of a millisecond."""

MOST_STARTS = 200
"""Random starts that are drawn; who wants more restarts meets them again."""


@dataclass(frozen=True)
class SinusoidOptions:
    """Options of `SinusoidSolver`.

    Attributes
    ----------
    harmonics : int
        N of equation (13); 0 takes the fewest that the number of parts allows.
    period : float
        Length of the cycle [s]; 0 takes one that suits the number of harmonics.
    at_rest : bool
        Whether cycles start and end with the plate at home and at rest. Costs two parameters for
        each degree of freedom; cycles of `steer` always do.
    tolerance : float
        Greatest force error that counts as success [mu m g].
    iterations : int
        Most steps from one start.
    restarts : int
        Most further starts when the first fails; `STARTS` times as many for averages.
    seed : int
        Seed of the further starts.
    """

    harmonics: int = 0
    period: float = 0.0
    at_rest: bool = False
    tolerance: float = 1e-4
    iterations: int = 40
    restarts: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(
            self,
            harmonics=(0, 64),
            period=(0.0, 10.0),
            tolerance=(0.0, 1.0),
            iterations=(1, 10_000),
            restarts=(0, 10_000),
            seed=(0, 2**31 - 1),
        )
        if self.at_rest and self.harmonics == 1:
            raise PlateError("harmonics is 1, allowed with at_rest: 0 (choose) or at least 2")


class Search(NamedTuple):
    """What `meet` needs for a family of motions; random motions (S, 3 h); knots of cycles [s]."""

    packed: Packed
    pool: np.ndarray
    times: np.ndarray


class SinusoidSolver(MotionSolver):
    """Plate motions made of sinusoids.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    **options
        Fields of `SinusoidOptions`.
    """

    def __init__(self, rig: Rig, **options: float) -> None:
        self.options: SinusoidOptions = make_options(SinusoidOptions, options)
        super().__init__(rig, self.options.seed)
        self._tables: dict[tuple[int, bool], GuessTable] = {}
        self._searches: dict[tuple[int, float, bool], Search] = {}
        self._warm: dict[tuple[int, float, bool], np.ndarray] = {}
        self._steering = SinusoidSteering(
            self._bounds, self.options.iterations, self.options.restarts
        )

    def forget(self) -> None:
        self._warm.clear()
        self._steering.forget()

    def _solve(self, request: Request) -> Solution:
        if request.traits.curled:
            return self._solve_with_curl(request)
        key = self._key(request.force.size, self.options.at_rest)
        search = self._search_of(key)
        tolerance = self.options.tolerance
        warm = self._warm.get(key)
        found: Found = meet(
            search.pool[:0] if warm is None else warm[None],
            search.pool,
            request.position,
            request.velocity,
            request.force,
            search.packed.numbers,
            search.packed.shapes,
            tolerance,
            self.options.iterations,
            STARTS * self.options.restarts + 1,
        )
        self._warm[key] = found.theta
        cycle = PlateCycle(search.times, found.pose, found.twist, found.accel, found.spline)
        message = f"force error {found.worst:.2g} mu m g after {found.iterations} iterations"
        if found.worst <= tolerance:
            return Solution(True, message, cycle, found.error, found.iterations, found.condition)
        got = float(np.sum(request.force * (request.force - found.error)))
        share = got / max(float(np.sum(request.force**2)), 1e-300)
        return Solution(
            success=False,
            message=f"{message}, allowed: {tolerance:g}",
            cycle=cycle,
            residual=found.error,
            iterations=found.iterations,
            condition=found.condition,
            status="failed",
            share=min(max(share, 0.0), 1.0),
        )

    def proven_out_of_reach(self, request: Request) -> bool:
        traits = request.traits
        if traits.moving or traits.slack or traits.curled:
            return False
        number = self._key(request.force.size, self.options.at_rest)[0]
        return is_out_of_reach(request.position, request.force, number, self._bounds.arm_m)

    def _solve_with_curl(self, request: Request) -> Solution:
        family, key = self._family(int(np.sum(request.rows)), self.options.at_rest)
        tolerance = self.options.tolerance
        fine = SinusoidFamily(harmonics(*key, steps=CURL_SAMPLES), self._bounds)
        most = self.options.iterations

        def attempt(theta: np.ndarray) -> Fit:
            return fit_force_finely(request, family, fine, theta, tolerance, most)

        def good(result: Fit) -> bool:
            return bool(np.max(np.abs(result.error)) <= tolerance)

        best, iterations = self._search(family, key, request.position, request.force, attempt, good)
        best = fit_force(request, fine, best.parameters, tolerance / 10, most)
        iterations += best.iterations
        self._warm[key] = best.parameters
        cycle = within_limits(self._bounds, family.cycle(best.parameters))
        return force_solution(request, best, cycle, tolerance, iterations, best.condition)

    def steer(self, goal: Goal, tolerance: float, good_enough: float) -> Solution:
        number, period, _ = self._key(goal.rows, True)
        best, cycle, condition = self._steering.steer(
            goal, number, period, tolerance, good_enough, self._rng
        )
        return steering_solution(
            self._bounds, goal, best, cycle, good_enough, best.iterations, condition
        )

    def steering_period(self, count: int, turns: int = 0) -> float:
        return self._key(2 * count + turns, True)[1]

    def _search(
        self,
        family: SinusoidFamily,
        key: tuple[int, float, bool],
        position: np.ndarray,
        force: np.ndarray,
        attempt: Callable[[np.ndarray], Fit],
        good: Callable[[Fit], bool],
    ) -> tuple[Fit, int]:
        """Try the last solution, then the table's guess, then random starts; keep the best."""
        start = self._warm.get(key)
        if start is None:
            start = family.admissible(self._guess(family, key, position, force))
        best = attempt(start)
        iterations = best.iterations
        for number in range(self.options.restarts):
            if good(best):
                break
            start = family.random(self._rng)
            if number % 2 == 0:  # stay near what is known, then look far away
                start = family.admissible(best.parameters + 0.7 * start)
            other = attempt(start)
            iterations += other.iterations
            if other.cost < best.cost:
                best = other
        return best, iterations

    def _guess(
        self,
        family: SinusoidFamily,
        key: tuple[int, float, bool],
        position: np.ndarray,
        force: np.ndarray,
    ) -> np.ndarray:
        """Return parameters from the table of first guesses."""
        number, _, at_rest = key
        table = self._tables.get((number, at_rest))
        if table is None:
            table = self._tables[number, at_rest] = guess_table(self._rig, number, at_rest)
        return family.parameters(table.nearest(position, force)[0])

    def _search_of(self, key: tuple[int, float, bool]) -> Search:
        """Return a family in plain numbers, and random motions to start from."""
        if key not in self._searches:
            basis, bounds = harmonics(*key), self._bounds
            motions = Motions(
                Waves(rules(key[0]), basis.span, np.array([1.0, 1.0, 1 / bounds.arm_m])),
                basis.pose,
                basis.twist,
                basis.accel,
                bounds.motor_rows,
                bounds.half,
                np.array([bounds.stroke_m, bounds.speed, bounds.accel]),
            )
            finish = Finish(
                basis.times,
                *basis.knots,
                basis.spline,
                basis.hull,
                bounds.motor_points,
                bounds.motor_directions,
                motions.most / MARGIN,
            )
            size = min(self.options.restarts + 1, MOST_STARTS) * FEW_CANDIDATES
            pool = np.random.default_rng(self._seed).normal(size=(size, 3 * basis.size))
            self._searches[key] = Search(packed(motions, finish), pool, basis.times)
        return self._searches[key]

    def _key(self, constraints: int, at_rest: bool) -> tuple[int, float, bool]:
        """Return harmonics, period and kind of the motions for so many forces."""
        number = self.options.harmonics or _harmonics_for(constraints, at_rest)
        if at_rest:
            number = max(number, 2)
        return number, self.options.period or _period_for(number, at_rest), at_rest

    def _family(
        self, constraints: int, at_rest: bool
    ) -> tuple[SinusoidFamily, tuple[int, float, bool]]:
        key = self._key(constraints, at_rest)
        return SinusoidFamily(harmonics(*key), self._bounds), key


def _harmonics_for(constraints: int, at_rest: bool) -> int:
    """Fewest harmonics with some parameters to spare (DESIGN: measured, not derived)."""
    if at_rest:  # rank 6 N - 7
        return 4 if constraints <= 4 else 6 if constraints <= 8 else 8
    return max(2, -(-(2 * constraints + 4) // 6))  # rank 6 N - 2


def _period_for(number: int, at_rest: bool) -> float:
    """Period [s]: long enough for the stroke to be used, short enough for quick answers."""
    if at_rest:
        return 0.1 if number <= 4 else 0.15 if number <= 6 else 0.2
    return 0.025 * number
