"""Method A (section 3.1 of the paper) on the cycle map: sequences of rotations.

A linear programme selects a few rotations from a library and determines their durations. The
rotations are sorted by priority and form a motion from rest to rest. Then the Levenberg-Marquardt
method corrects durations and twists until the goal is met. Basin hopping provides further starts.
The input is a `Goal`, and the output is a `Solution`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plate_core import Rig

from ..fit import Fit, basin_hopping, fit
from ..goal import Goal, Solution, goal_solution
from ..library import Library
from ..limits import within_limits
from ..motion_solver import MotionSolver, check_options, make_options
from .family import RotationFamily
from .plan import RotationPlan, plan_rotations

FEW = (2, 4)
"""Numbers of parts up to which a cycle is shortened. With up to 2 parts, a cycle lasts half of the
option `period`. With up to 4 parts, a cycle lasts three quarters of this period. A few parts
require only a few rotations. With a shorter cycle, the next request is processed earlier."""

SETTLE = 0.05
"""Approximate time in which friction stops a part that has an initial velocity [s]."""

PUSH = 0.04
"""Drift in a plan that moves parts towards targets [m/s]. This value applies to the part with the
longest displacement."""

FINER = 3
"""Factor that increases the number of time steps of a search. The factor is used if a search meets
the goal, but the evaluation with fine steps does not confirm the result. The search then continues
with the increased number of steps."""

POLISH = 6
"""Maximum number of iterations of a search that continues with an increased number of time steps
(see `FINER`)."""

SHAKE = 0.3
"""Standard deviation of a random change of the best parameters, in units of the parameters."""

SPREAD = 0.3
"""Maximum random increase of the cost of each rotation in further plans. With the changed costs,
the linear programme selects other rotations of similar quality."""


@dataclass(frozen=True)
class RotationOptions:
    """Options of `RotationCycles`.

    Attributes
    ----------
    period : float
        Length of the cycle [s]. The actual length is half of this value for one or two parts, and
        three quarters of it for three or four parts.
    speed : float
        Usual speed of the plate's fastest corner in a rotation [m/s].
    max_price : float
        Maximum time per unit of force on a part [cycles / (mu m g)]. The plan does not meet forces
        that cost more. An example is a force that separates two parts that almost touch.
    iterations : int
        Maximum number of iterations of a search that starts from the last motion. For all other
        starts, the maximum is twice this number.
    restarts : int
        Maximum number of further starts if the first one fails. If the first start is the last
        motion, one additional start is permitted.
    seed : int
        Random seed of the further starts.
    """

    period: float = 0.2
    speed: float = 0.25
    max_price: float = 30.0
    iterations: int = 40
    restarts: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(
            self,
            period=(1e-3, 10.0),
            speed=(1e-3, 10.0),
            max_price=(1.0, 1e6),
            iterations=(1, 10_000),
            restarts=(0, 10_000),
            seed=(0, 2**31 - 1),
        )


class Start(NamedTuple):
    """Start of a search: a family of motions and its parameters."""

    family: RotationFamily
    parameters: np.ndarray


class Try(NamedTuple):
    """Result of a search, and the family that its parameters belong to."""

    family: RotationFamily
    fit: Fit


class RotationCycles(MotionSolver):
    """Solver that moves parts to a goal by cycles of rotations.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    **options
        Fields of `RotationOptions`.
    """

    kind = RotationOptions

    def __init__(self, rig: Rig, **options: float | str) -> None:
        self.options: RotationOptions = make_options(self.kind, options)
        super().__init__(rig, self.options.seed)
        self.library = Library.around(rig.plate.half)
        self._last_start: Start | None = None
        self._last_basis: np.ndarray | None = None

    def forget(self) -> None:
        self._last_start = self._last_basis = None

    def steering_period(
        self, count: int, rotating_parts: int = 0, multi_cycle: bool = False, free_end: bool = False
    ) -> float:
        return self.options.period * (0.5 if count <= FEW[0] else 0.75 if count <= FEW[1] else 1.0)

    def steer(
        self, goal: Goal, tolerance: float, good_enough: float, until: float = math.inf
    ) -> Solution:
        options, enough = self.options, good_enough**2 * goal.requested_count
        period = self.steering_period(len(goal.position))
        if self._last_start is not None and self._last_start.family.period != period:
            # the last solution has another period, because the number of parts has changed
            self._last_start = None
        warm = self._last_start is not None

        def attempt(start: Start, n: int) -> tuple[Try, float, int, bool]:
            max_iterations = options.iterations if warm and n == 0 else 2 * options.iterations
            found = fit_goal(goal, *start, tolerance, max_iterations)
            return Try(start.family, found), found.cost, found.iterations, found.cost <= enough

        def propose(number: int, near: Try, fresh: bool) -> Start:
            return self.planned(goal, spread=number > warm) if fresh else self._shaken(near)

        def expired() -> bool:
            late = time.monotonic() > until
            self.cut_short += late
            return late

        begin, tries = self._last_start or self.planned(goal), 1 + options.restarts + warm
        best, iterations = basin_hopping(propose, attempt, begin, tries, warm, expired)
        family, found = best
        self._last_start = Start(family, found.parameters)
        solution = self._finished(goal, best, good_enough, iterations)
        # the time steps of the search were too coarse
        if found.cost <= enough and not solution.success:
            ramp, hold = family.kernel_data.steps
            fine = family.with_steps((FINER * ramp, FINER * hold))
            found = fit_goal(goal, fine, found.parameters, tolerance, POLISH)
            iterations += found.iterations
            solution = self._finished(goal, Try(fine, found), good_enough, iterations)
        return solution

    def _finished(self, goal: Goal, best: Try, good_enough: float, iterations: int) -> Solution:
        cycle = within_limits(best.family.cycle(best.fit.parameters), self._full)
        return goal_solution(goal, cycle, good_enough, iterations, best.fit.condition)

    def _shaken(self, near: Try) -> Start:
        parameters = near.fit.parameters
        shaken = parameters + SHAKE * self._rng.normal(size=len(parameters))
        return Start(near.family, near.family.admissible(shaken))

    def planned(self, goal: Goal, spread: bool = False) -> Start:
        """Return a start for the search. The start is computed from a plan that uses averaged
        forces.

        The requested force F on a part of mass m is constant. The force moves the part by the
        displacement d from rest in the period T: F = 2 m d / T^2. If targets are requested, d is in
        the direction of steepest descent.
        """
        period = self.steering_period(len(goal.position))
        unit = 0.5 * period**2 * goal.friction_accel[:, None]
        push = goal.displacement - SETTLE * goal.velocity
        if goal.multi_cycle:
            push = goal.downhill(PUSH * period)
        slack = 0.0 if goal.multi_cycle else 0.5 * goal.tolerance
        force = np.sign(push) * np.maximum(np.abs(push) - slack, 0.0) / unit
        curl = None
        if goal.part_rotations is not None:
            # In a friction field with this curl, a disc has the angular acceleration mu g curl/2.
            # If the disc starts at rest, it rotates by mu g curl T^2/4 during the period T.
            curl = goal.part_rotations.middle * 4 / (goal.friction_accel * period**2)
            curl = np.where(goal.part_rotations.weight > 0, curl, np.nan)
        plan = self._plan(goal.position, force, curl, spread)
        plan = plan.in_order(np.argsort(-plan.priority, kind="stable"))
        family = RotationFamily(plan.twist, self._limits, period, self.options.speed)
        return Start(family, family.parameters(plan.fraction))

    def _plan(
        self, position: np.ndarray, force: np.ndarray, curl: np.ndarray | None, spread: bool
    ) -> RotationPlan:
        cost = 1 + SPREAD * self._rng.random(len(self.library.twist)) if spread else None
        price, basis = self.options.max_price, self._last_basis
        plan = plan_rotations(self.library, position, force, curl, price, basis, cost)
        self._last_basis = plan.times.basis
        return plan


def fit_goal(
    goal: Goal, family: RotationFamily, parameters: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Fit the parameters of a motion to a goal by Levenberg-Marquardt.

    The errors are those of `Goal.error` and `RotationFamily.penalty` [m]. The search stops when the
    largest error is at most `tolerance` [m].
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        samples = family.samples(theta)
        error, slope = goal.error(goal.end(*samples))

        def slopes() -> np.ndarray:
            jacobian = family.pull_back(theta, *goal.end_slopes(*samples))
            return np.vstack([slope @ jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error, family.penalty(theta)]), slopes

    return fit(evaluate, family.admissible, parameters, tolerance, iterations)
