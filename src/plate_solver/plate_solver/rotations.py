"""Method A: sequences of rotations (section 3.1 of the paper).

The linear problem gives weights of rotations about fixed centres; three more rows ask the sequence
to close. The weights become lengths of a sequence in time, from rest to rest, whose lengths and
speeds are then corrected, on the averaged map or on the cycle map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plate_core import PlateError, Rig

from .averaged import CURL_LENGTH_M, fit_force, fit_force_finely, force_solution
from .centres import curl_matrix, grid, priority_order, rotation_matrix, solve_weights, unit_twists
from .force_map import SAMPLES
from .least_squares import Fit
from .rotation_family import RotationFamily
from .solution import Request, Solution, check_options
from .solver import MotionSolver, make_options
from .steering import Goal, steer, steering_solution

SHAKE = 0.4
"""How far a further start is from the best so far, in units of the parameters."""


@dataclass(frozen=True)
class RotationOptions:
    """Options of `RotationSolver`.

    Attributes
    ----------
    period : float
        Length of the cycle [s].
    speed : float
        Usual speed of the plate's fastest corner in a rotation [m/s].
    most_gain : float
        Bound on inverse singular values of the linear problem [-].
    tolerance : float
        Greatest force error that counts as success [mu m g].
    iterations : int
        Most steps from one start.
    restarts : int
        Most further starts when the first fails.
    seed : int
        Seed of the further starts.
    """

    period: float = 0.2
    speed: float = 0.25
    most_gain: float = 30.0
    tolerance: float = 1e-3
    iterations: int = 40
    restarts: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(
            self,
            period=(1e-3, 10.0),
            speed=(1e-3, 10.0),
            most_gain=(1.0, 1e12),
            tolerance=(0.0, 1.0),
            iterations=(1, 10_000),
            restarts=(0, 10_000),
            seed=(0, 2**31 - 1),
        )


class RotationSolver(MotionSolver):
    """Plate motions made of rotations.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    centres : (N, 2), optional
        Centres of rotation [m], plate_home; 24 on a grid over the plate if left out.
    **options
        Fields of `RotationOptions`.
    """

    def __init__(self, rig: Rig, centres: np.ndarray | None = None, **options: float) -> None:
        self.options: RotationOptions = make_options(RotationOptions, options, "centres")
        super().__init__(rig, self.options.seed)
        self.centres = grid(rig.plate.half) if centres is None else np.array(centres, dtype=float)
        if self.centres.ndim != 2 or self.centres.shape[1] != 2 or len(self.centres) < 3:
            raise PlateError(
                f"centres have shape {self.centres.shape}, allowed: (N, 2) with N at least 3"
            )
        if not np.all(np.isfinite(self.centres)):
            raise PlateError("centres have values that are not finite")
        self._twists = unit_twists(self.centres, rig.plate.half)
        self._warm: tuple[RotationFamily, np.ndarray] | None = None

    def forget(self) -> None:
        self._warm = None

    def steering_period(self, count: int) -> float:
        return self.options.period

    def _solve(self, request: Request) -> Solution:
        start, family, condition = self._plan(request.position, request.force, request.curl)
        tolerance = self.options.tolerance
        fine, most = family.finer(SAMPLES), self.options.iterations

        def attempt(theta: np.ndarray) -> Fit:
            return fit_force_finely(request, family, fine, theta, tolerance, most)

        def good(result: Fit) -> bool:
            return bool(np.max(np.abs(result.error)) <= tolerance)

        first = attempt(start)
        best, iterations = self._again(first, first.iterations, family, attempt, good)
        best = fit_force(request, fine, best.parameters, tolerance / 10, most)
        iterations += best.iterations
        cycle = fine.cycle(best.parameters)
        return force_solution(self._rig, request, best, cycle, tolerance, iterations, condition)

    def steer(self, goal: Goal, tolerance: float, good_enough: float) -> Solution:
        most = self.options.iterations

        def good(result: Fit) -> bool:
            return result.cost <= good_enough**2 * goal.position.size

        best, iterations, condition = None, 0, float("nan")
        if self._warm is not None:
            family, theta = self._warm
            best = steer(goal, family, theta, tolerance, most)
            iterations = best.iterations
        if best is None or not good(best):
            theta, fresh, condition = self._plan_displacement(goal)
            other = steer(goal, fresh, theta, tolerance, 2 * most)
            iterations += other.iterations
            if best is None or other.cost < best.cost:
                best, family = other, fresh

        def attempt(theta: np.ndarray) -> Fit:
            return steer(goal, family, theta, tolerance, 2 * most)

        best, iterations = self._again(best, iterations, family, attempt, good)
        self._warm = family, best.parameters
        return steering_solution(
            self._rig, goal, best, family.cycle(best.parameters), good_enough, iterations,
            condition if np.isfinite(condition) else best.condition,
        )  # fmt: skip

    def _again(
        self,
        best: Fit,
        iterations: int,
        family: RotationFamily,
        attempt: Callable[[np.ndarray], Fit],
        good: Callable[[Fit], bool],
    ) -> tuple[Fit, int]:
        """Start again some way from the best, until it is good; returns iterations in all."""
        for _ in range(self.options.restarts):
            if good(best):
                break
            shaken = best.parameters + SHAKE * self._rng.normal(size=len(best.parameters))
            other = attempt(family.admissible(shaken))
            iterations += other.iterations
            if other.cost < best.cost:
                best = other
        return best, iterations

    def _plan_displacement(self, goal: Goal) -> tuple[np.ndarray, RotationFamily, float]:
        """Plan with the force that would give the displacements from the start velocities."""
        period = self.options.period
        impulse = goal.displacement - goal.velocity * period
        force = impulse / (0.5 * period**2 * goal.friction_accel)
        return self._plan(goal.position, force, np.full(len(force), np.nan))

    def _plan(
        self, position: np.ndarray, force: np.ndarray, curl: np.ndarray
    ) -> tuple[np.ndarray, RotationFamily, float]:
        """Solve the linear problem with three rows for closure, and put it in the paper's order."""
        asked = np.isfinite(curl)
        matrix = np.vstack(
            [
                rotation_matrix(position, self.centres),
                curl_matrix(position, self.centres)[asked] * CURL_LENGTH_M,
                self._twists.T,
            ]
        )
        wanted = np.concatenate([force.T.ravel(), curl[asked] * CURL_LENGTH_M, np.zeros(3)])
        share, condition = solve_weights(matrix, wanted, self.options.most_gain)
        order = priority_order(share, position, self.centres)
        options = self.options
        family = RotationFamily(self._twists[order], self._bounds, options.period, options.speed)
        return family.parameters(share[order]), family, condition
