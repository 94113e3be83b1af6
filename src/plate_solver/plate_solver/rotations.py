"""Method A: sequences of rotations (section 3.1 of the paper).

A linear programme picks few rotations out of a library and how long each is to last. Put in order
they become a motion from rest to rest, whose lengths and twists are then corrected, on the averaged
map or on the cycle map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from plate_core import PlateCycle, PlateError, Rig

from .averaged import force_solution
from .force_map import average_force
from .least_squares import Fit
from .library import Library
from .ordering import best_order, nearest_order
from .rotation_family import RotationFamily
from .rotation_fit import fit_displacement, fit_mean_force, mean_force_error, missed
from .rotation_plan import RotationPlan, plan_rotations, reachable_share, with_return_strokes
from .solution import Request, Solution, check_options, within_limits
from .solver import MotionSolver, make_options
from .steering import Goal, steering_solution

FEW = (2, 4)
"""Numbers of parts up to which half and three quarters of the period will do on the cycle map: the
answer comes sooner, and fewer rotations have to fit in."""

SETTLE = 0.05
"""Time in which shaking takes away a part's velocity, about [s]."""

CLOSURES = ("sequence", "strokes")
ORDERS = ("auto", "nearest", "priority", "simulated")

AVERAGED, FINE, FINEST = (20, 4), (60, 20), (600, 200)
"""Steps in every ramp and hold when an average force is corrected, when that is done for good, and
when a curl is judged: in a ramp the surface may almost stand still under a part."""

FINER, POLISH = 3, 6
"""A search that finer steps do not confirm goes on with so many times the steps, for so long."""

SHAKE = 0.3
"""How far a shaken start is from the best so far, in units of the parameters."""

SPREAD = 0.3
"""Random part of the costs of rotations in further plans: it picks other rotations, as good."""

ORDER_TRIES = 200
"""Sequences that are simulated in search of a better order."""


@dataclass(frozen=True)
class RotationOptions:
    """Options of `RotationSolver`.

    Attributes
    ----------
    period : float
        Length of the cycle [s]; on the cycle map half of it for up to two parts, three quarters for
        up to four.
    speed : float
        Usual speed of the plate's fastest corner in a rotation [m/s].
    blend : float
        Least time from one rotation to the next [s]: smooths the motion (3.2).
    closure : str
        `sequence`: the motion closes as a whole; `strokes`: each rotation is turned back at once.
    order : str
        `nearest`: least change of twist; `priority`: section 3.1.4; `simulated`: the one of some
        hundred with the least error on the cycle map; `auto`: `nearest` for average forces, which
        know of no order, as ramps then take the least time; `priority` on the cycle map, as parts
        and plate stay closest to where they were.
    most_price : float
        Most time that a unit of force on a part may cost [cycles / (mu m g)]: what costs more, such
        as parting two parts that almost touch, is given up in the plan.
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
    blend: float = 0.0
    closure: str = "sequence"
    order: str = "auto"
    most_price: float = 30.0
    tolerance: float = 1e-3
    iterations: int = 40
    restarts: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(
            self,
            period=(1e-3, 10.0),
            speed=(1e-3, 10.0),
            blend=(0.0, 1.0),
            most_price=(1.0, 1e6),
            tolerance=(0.0, 1.0),
            iterations=(1, 10_000),
            restarts=(0, 10_000),
            seed=(0, 2**31 - 1),
        )
        for name, allowed in (("closure", CLOSURES), ("order", ORDERS)):
            if getattr(self, name) not in allowed:
                raise PlateError(
                    f"{name} is {getattr(self, name)!r}, allowed: {', '.join(allowed)}"
                )


class RotationSolver(MotionSolver):
    """Plate motions made of rotations.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    centres : (N, 2), optional
        Centres of rotation [m], plate_home: these and no others. If left out, sequences start from
        a library of centres and translations, and their centres move as the request asks.
    **options
        Fields of `RotationOptions`.
    """

    def __init__(self, rig: Rig, centres: np.ndarray | None = None, **options: float | str) -> None:
        self.options: RotationOptions = make_options(RotationOptions, options, "centres")
        super().__init__(rig, self.options.seed)
        self._free = centres is None
        if centres is None:
            self.library = Library.around(rig.plate.half)
        else:
            self.library = Library.about(_checked(centres), rig.plate.half)
        self._warm: tuple[RotationFamily, np.ndarray] | None = None
        self._last: tuple[np.ndarray, RotationFamily, np.ndarray] | None = None
        self._basis: np.ndarray | None = None

    def forget(self) -> None:
        self._warm = self._basis = self._last = None

    def steering_period(self, count: int, turns: int = 0) -> float:
        return self.options.period * (0.5 if count <= FEW[0] else 0.75 if count <= FEW[1] else 1.0)

    def _solve(self, request: Request) -> Solution:
        options, iterations = self.options, 0
        best: Fit | None = None
        for k in range(1 + options.restarts):
            if (
                k == 0
                and self._last is not None
                and np.array_equal(self._last[0], request.position)
            ):
                coarse, start = self._last[1:]
            elif best is None or k % 2 == 0:
                plan = self._plan(request.position, request.force, request.curl, k > 0, fill=True)
                coarse, start = self._family(plan, options.period, averaged=True)
            else:
                start = coarse.admissible(self._shaken(best.parameters))
            found = fit_mean_force(
                request, coarse, start, options.tolerance / 4, options.iterations
            )
            iterations += found.iterations
            if best is None or found.cost < best.cost:
                best, family = found, coarse
            if np.max(np.abs(best.error)) <= options.tolerance:
                break
        assert best is not None
        self._last = request.position, family, best.parameters
        cycle, error = self._judged(request, family, best.parameters)
        if np.max(np.abs(error)) > options.tolerance:  # the samples missed a dip
            fine = family.finer(FINE)
            stop = options.tolerance / 10
            best = fit_mean_force(request, fine, best.parameters, stop, options.iterations)
            iterations += best.iterations
            cycle, error = self._judged(request, fine, best.parameters)
        solution = force_solution(
            request, replace(best, error=error), cycle, options.tolerance, iterations,
            best.condition,
        )  # fmt: skip
        if solution.success or np.any(request.velocity):
            return solution
        share = reachable_share(self.library, request.position, request.force)
        if share >= 1:
            return solution
        return replace(solution, message=f"{solution.message}; about {share:.2g} of it is in reach")

    def _judged(
        self, request: Request, family: RotationFamily, parameters: np.ndarray
    ) -> tuple[PlateCycle, np.ndarray]:
        """Return the motion within the limits and its true errors in the rows asked for."""
        cycle = within_limits(self._bounds, family.cycle(parameters))
        error = np.zeros(np.count_nonzero(request.rows))
        if np.any(np.isfinite(request.curl)):
            error = mean_force_error(request, family.finer(FINEST), parameters)
        true = request.force - average_force(cycle, request.position, request.velocity)
        error[np.flatnonzero(request.rows) % 3 < 2] = true.ravel()
        return cycle, error

    def steer(self, goal: Goal, tolerance: float, good_enough: float) -> Solution:
        best: Fit | None = None
        iterations = 0
        for candidate, start, most in self._starts(goal):
            found = fit_displacement(goal, candidate, start, tolerance, most)
            iterations += found.iterations
            if best is None or found.cost < best.cost:
                best, family = found, candidate
                self._warm = family, best.parameters
            if best.cost <= good_enough**2 * goal.rows:
                break
        assert best is not None
        cycle, error = self._foreseen(goal, family, best)
        if best.cost <= good_enough**2 * goal.rows < error @ error:  # too coarse a search
            fine = family.finer(FINER)
            best = fit_displacement(goal, fine, best.parameters, tolerance, POLISH)
            iterations += best.iterations
            cycle, error = self._foreseen(goal, fine, best)
        return steering_solution(
            self._bounds, goal, replace(best, error=error), cycle, good_enough, iterations,
            best.condition,
        )  # fmt: skip

    def _foreseen(
        self, goal: Goal, family: RotationFamily, found: Fit
    ) -> tuple[PlateCycle, np.ndarray]:
        """Return the motion within the limits, and its errors by a finer prediction."""
        cycle = within_limits(self._bounds, family.cycle(found.parameters))
        return cycle, np.concatenate([missed(goal, cycle), found.error[goal.rows :]])

    def _starts(self, goal: Goal) -> Iterator[tuple[RotationFamily, np.ndarray, int]]:
        """Yield where to search from, and for how long: the last answer, plans, shaken ones."""
        most = self.options.iterations
        period = self.steering_period(len(goal.position))
        if self._warm is not None and self._warm[0].period != period:
            self._warm = None  # other parts
        if self._warm is not None:
            yield *self._warm, most
        for k in range(1 + self.options.restarts):
            if k % 2 == 0 or self._warm is None:
                yield *self.planned(goal, spread=k > 0), 2 * most
            else:
                family, parameters = self._warm
                yield family, family.admissible(self._shaken(parameters)), 2 * most

    def _shaken(self, parameters: np.ndarray) -> np.ndarray:
        return parameters + SHAKE * self._rng.normal(size=len(parameters))

    def planned(self, goal: Goal, spread: bool = False) -> tuple[RotationFamily, np.ndarray]:
        """Plan with the force that would move parts from rest by what is asked at least."""
        period = self.steering_period(len(goal.position))
        unit = 0.5 * period**2 * goal.friction_accel[:, None]
        push = goal.displacement - SETTLE * goal.velocity
        force = np.sign(push) * np.maximum(np.abs(push) - 0.5 * goal.tolerance, 0.0) / unit
        curl = None
        if goal.turns is not None:  # what turns a disc from rest by what is asked
            curl = goal.turns.wanted * 4 / (goal.friction_accel * period**2)
        plan = self._plan(goal.position, force, curl, spread)
        if self.options.order != "simulated":
            return self._family(plan, period)

        def error(order: np.ndarray) -> float:
            family, parameters = self._family(plan.in_order(order), period)
            return fit_displacement(goal, family, parameters, 0.0, 0).cost

        first = np.arange(len(plan.share))
        best = best_order(error, first, ORDER_TRIES, self._rng)
        return self._family(plan.in_order(best), period)

    def _plan(
        self,
        position: np.ndarray,
        force: np.ndarray,
        curl: np.ndarray | None,
        spread: bool,
        fill: bool = False,
    ) -> RotationPlan:
        options, half = self.options, self._bounds.half
        cost = None
        if spread:
            cost = 1 + SPREAD * self._rng.random(len(self.library.twist))
        plan = plan_rotations(
            self.library, position, force, curl, options.most_price, self._basis, cost
        )
        self._basis = plan.shares.basis
        if fill:
            plan = plan.filled()
        if options.order == "priority" or (options.order == "auto" and not fill):
            return plan.in_order(np.argsort(-plan.priority, kind="stable"))
        return plan.in_order(nearest_order(plan.twist, half))

    def _family(
        self, plan: RotationPlan, period: float, averaged: bool = False
    ) -> tuple[RotationFamily, np.ndarray]:
        """Return the plan as a family of motions, and the plan's parameters in it."""
        options = self.options
        if options.closure == "strokes":
            plan = with_return_strokes(plan)
        family = RotationFamily(
            plan.twist,
            self._bounds,
            period,
            options.speed,
            self._free,
            options.blend,
            AVERAGED if averaged else None,
            averaged,
        )
        return family, family.parameters(plan.share)


def _checked(centres: np.ndarray) -> np.ndarray:
    centres = np.array(centres, dtype=float)
    if centres.ndim != 2 or centres.shape[1] != 2 or len(centres) < 3:
        raise PlateError(f"centres have shape {centres.shape}, allowed: (N, 2) with N at least 3")
    if not np.all(np.isfinite(centres)):
        raise PlateError("centres have values that are not finite")
    return centres
