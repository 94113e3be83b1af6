"""Computes the next plate cycle from the planner's request, in four steps.

1. `predict_start` predicts the state of the parts and the plate when the cycle begins.
2. `form_goal` converts the request (forces or targets) to intervals for the displacements.
3. `search` finds a plate motion for the goal.
4. `leaves_plate` checks whether the motion moves a part off the plate. If the motion does,
   `Controller` searches again for a smaller fraction of the goal. If the smallest fraction also
   fails, `Controller` returns a cycle at rest.

Between calls, `Controller` stores the predicted velocities of the parts. Each solver stores its
last motion, from which the next search starts, and its random number generator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plate_core import CycleRequest, Parts, PlateCycle, PlateError, Rig
from plate_core.motion import IDLE_S

from .cycle_map import finely_sampled
from .goal import Goal, Solution, Status
from .goal.conversion import RequestFacts, form_goal
from .motion_solver import MotionSolver
from .rotations.solver import RotationCycles
from .sinusoids.solver import SinusoidCycles
from .start import Memory, part_types, predict_start

METHODS = {"A": "rotations", "B": "sinusoids", "rotations": "rotations", "sinusoids": "sinusoids"}
"""Allowed names of the methods. The names are the letters A and B of the paper, and the names in
this project."""

DRIFT_TOLERANCE = 5e-5
"""Displacement error at which a search for forces ends the descent from one start, divided by the
length of the cycle [m/s]. The largest error of a single coordinate must be below this value. The
search over several starts ends at the error `GOOD_MISS` or `EXACT_MISS`."""

TARGET_TOLERANCE = 2e-4
"""Displacement error at which a search for targets ends, divided by the length of the cycle [m/s].
The descent from one start ends when the largest error of a single coordinate is below this value.
The search over several starts ends when the root mean square error is below this value. Later
cycles correct the remaining error."""

FRACTIONS = (1.0, 0.5, 0.25)
"""Fractions of a goal. The solver tries the fractions in this order until no part leaves the plate.
If forces are requested, the displacements and rotations are multiplied by the fraction. If targets
are requested, their weights are multiplied by the square of the fraction (`Goal.scaled`)."""

GOOD_MISS = 0.15
"""Maximum acceptable error (root mean square), as a fraction of the requested displacement. If the
error is larger, the solver searches from further starts."""

EXACT_MISS = 0.02
"""Value that replaces `GOOD_MISS` if forces are requested and at least one part has zero tolerance
on both axes."""

LOOKAHEAD_S = 0.03
"""Time by which the solver extrapolates the motion of the parts beyond the end of a cycle, at their
final velocities [s]. With the extrapolation, the solver prefers motions after which parts move
towards their targets. The extrapolation is used only if targets are requested and a part is far
from its target. Close to their targets, parts would oscillate with it."""


EFFORT: dict[str, dict[str, Any]] = {
    "rotations": {"iterations": 20, "restarts": 1},
    "sinusoids": {"iterations": 16, "restarts": 40},
}
"""Options of the solvers in closed-loop control, as in `RotationOptions` and `SinusoidOptions`.
With larger values, the search is slower and the result is hardly better (docs/results.md)."""


@dataclass(frozen=True)
class CycleResult:
    """Result of `Controller.solve`. The result contains the next cycle, and the accuracy with
    which this cycle meets the request.

    Attributes
    ----------
    cycle : PlateCycle
        The next cycle. Rotations always start and end at rest at home. Sinusoids do the same if
        `CycleRequest.plate` or `CycleRequest.start` is None. Otherwise sinusoids start in the state
        `CycleRequest.plate`, and have a free end (`Goal.free_end`) while a part is far from its
        target. The cycle has a tail if it starts in motion or has a free end. If a cycle at rest
        replaces the result of a search, it starts with the plate at rest. If the plate is in motion
        before such a cycle, it first plays the tail of the running cycle.
    solution : Solution or None
        Result of the search. None if no search was necessary, because there are no parts or because
        a plate at rest meets the request exactly.
    message : str
        Text for the log.
    error_m, requested_m : float
        Displacement error and requested displacement [m]. Error and displacement are root mean
        squares over parts and axes. A rotation counts as the arc length at the edge of the part.
        Error and displacement are 0 if targets are requested.
    fraction : float
        Fraction of the goal that the search used, one of `FRACTIONS`. 0 if the plate rests because
        a part would leave it.
    """

    cycle: PlateCycle
    solution: Solution | None
    message: str
    error_m: float
    requested_m: float
    fraction: float = 1.0


class Controller:
    """Computes the cycles of the plate one after the other. Between two cycles, it stores the
    predicted velocities of the parts.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    method : str
        A key of `METHODS`.
    seed : int
        Seed of the solvers' random starts.
    threads : int
        Number of threads that a search uses.
    **effort
        Options `iterations` and `restarts` of the solvers. Default: `EFFORT`.

    Raises
    ------
    PlateError
        If the method is unknown.
    """

    def __init__(
        self,
        rig: Rig,
        method: str = "sinusoids",
        seed: int = 0,
        threads: int = 1,
        **effort: int,
    ) -> None:
        if method not in METHODS:
            raise PlateError(f"method is {method!r}, allowed: {', '.join(METHODS)}")
        self._rig = rig
        self._solvers: dict[str, MotionSolver] = {
            "rotations": RotationCycles(rig, seed=seed, **EFFORT["rotations"] | effort),
            "sinusoids": SinusoidCycles(
                rig, seed=seed, threads=threads, **EFFORT["sinusoids"] | effort
            ),
        }
        self._memory = Memory()
        self.method = METHODS[method]

    @property
    def cut_short(self) -> int:
        """Number of searches that the deadline `until` of `solve` ended early."""
        return sum(solver.cut_short for solver in self._solvers.values())

    def reset(self) -> None:
        """Delete the stored velocities of parts and the stored solutions."""
        self._memory = Memory()
        for solver in self._solvers.values():
            solver.reset()

    def warm_up(self) -> None:
        """Solve test requests with each method, then delete the stored data. The test requests load
        the force tables and all libraries, so that the first real request is not delayed."""
        rest = PlateCycle.rest(IDLE_S)
        rotated = Parts.make(("part_0",), np.zeros((1, 2)))
        requests = [CycleRequest.make(rotated, torque=np.array([1e-6]))]
        for count in (2, 4, 6):
            angle = 2 * np.pi * np.arange(count) / count
            position = 0.5 * self._rig.plate.half * np.column_stack([np.cos(angle), np.sin(angle)])
            parts = Parts.make(tuple(f"part_{i}" for i in range(count)), position)
            requests.append(CycleRequest.make(parts, 1e-4 * np.ones((count, 2))))
        for request in requests:
            for method in self._solvers:
                self._solve(method, request, rest, math.inf)
        self.reset()

    def solve(
        self, request: CycleRequest, running: PlateCycle | None, until: float = math.inf
    ) -> CycleResult:
        """Compute the cycle that follows the running cycle.

        Parameters
        ----------
        request : CycleRequest
            Request with the parts as detected at the start of the running cycle.
        running : PlateCycle, optional
            Running cycle of the plate. None if the plate is at rest.
        until : float
            Deadline of the search [s], as in `MotionSolver.steer`.

        Raises
        ------
        PlateError
            If the request cannot be converted to a goal, see `form_goal`.
        """
        return self._solve(self.method, request, running, until)

    def _solve(
        self, method: str, request: CycleRequest, running: PlateCycle | None, until: float
    ) -> CycleResult:
        if not len(request.parts):
            self._memory = Memory()
            return CycleResult(PlateCycle.rest(IDLE_S), None, "no parts, plate at rest", 0.0, 0.0)
        rig, solver, facts = self._rig, self._solvers[method], RequestFacts.of(self._rig, request)
        certain = request.plate is not None and request.start is not None
        free_end = method == "sinusoids" and facts.far and certain
        period = solver.steering_period(
            len(request.parts), facts.rotating_parts or 0, facts.multi_cycle, free_end
        )
        rotates = facts.rotating_parts is not None
        start = predict_start(rig, request, self._memory, running, rotates, method == "rotations")
        self._memory = start.memory
        goal = form_goal(rig, request, start, period, LOOKAHEAD_S if facts.far else 0.0, free_end)
        rest = PlateCycle.rest(period)
        if not np.any(goal.error(goal.end(*finely_sampled(rest)))[0]):
            if goal.multi_cycle:
                return CycleResult(
                    rest, None, "all parts are at their targets: plate at rest", 0.0, 0.0
                )
            return CycleResult(rest, None, "no motion is requested: plate at rest", 0.0, goal.size)
        for fraction in FRACTIONS:
            miss = EXACT_MISS if facts.exact else GOOD_MISS
            solution = search(solver, goal, fraction, period, miss, until)
            if not leaves_plate(rig, request.parts.ids, goal, np.asarray(solution.predicted)):
                return result_of(goal, solution, fraction, period)
            solver.forget()
        return refusal(goal, solution, rest)


def search(
    solver: MotionSolver, goal: Goal, fraction: float, period: float, miss: float, until: float
) -> Solution:
    """Search for a motion that meets a fraction of a goal (`Goal.scaled`).

    Parameters
    ----------
    solver : MotionSolver
        The search starts from the solver's last motion, and uses its random generator.
    goal : Goal
    fraction : float
        Fraction of the goal, 0 to 1, as in `Goal.scaled`.
    period : float
        Length of the cycle [s].
    miss : float
        Maximum acceptable error (root mean square), as a fraction of the requested displacements.
        If the error is larger, the solver searches from further starts. Not used if
        `goal.multi_cycle` is True.
    until : float
        Deadline of the search [s], as in `MotionSolver.steer`.
    """
    tolerance = period * (TARGET_TOLERANCE if goal.multi_cycle else DRIFT_TOLERANCE)
    good_enough = 0.0 if goal.multi_cycle else miss * fraction * goal.size
    return solver.steer(goal.scaled(fraction), tolerance, max(good_enough, tolerance), until)


def leaves_plate(rig: Rig, ids: tuple[str, ...], goal: Goal, predicted: np.ndarray) -> bool:
    """Return whether a motion would move a part off the plate. The criterion is that the centre of
    a part ends less than half a radius from an edge, and farther out than at the start.

    The radius is that of a disc with the same area as the part. Only the predicted end positions
    are checked. The predicted positions are extrapolated by the time `Goal.coast`.

    Parameters
    ----------
    rig : Rig
    ids : tuple of M str
    goal : Goal
        Goal of the cycle. A part may leave the plate over an edge if its goal is beyond this edge.
    predicted : (C,)
        Predicted coordinates at the end of the cycle, in the order of `Goal.end`.
    """
    end = predicted[: goal.position.size].reshape(2, -1).T
    radius = np.sqrt([[kind.area_m2 / np.pi] for kind in part_types(rig, ids)])
    edge = rig.plate.half - 0.5 * radius
    middle = goal.position + goal.displacement
    goal_outside = np.abs(middle) - goal.tolerance > edge
    out = (np.abs(end) > edge) & ~(goal_outside & (end * middle > 0))
    return bool(np.any(out & (np.abs(end) > np.abs(goal.position))))


def result_of(goal: Goal, solution: Solution, fraction: float, period: float) -> CycleResult:
    """Convert the solution of a fraction of a goal to a `CycleResult`.

    `CycleResult.error_m` and the residual of the solution refer to the whole goal, not to the
    fraction.
    """
    if goal.multi_cycle:
        return CycleResult(solution.cycle, solution, solution.message, 0.0, 0.0, fraction)
    unit = goal.friction_accel[:, None] * period**2
    if fraction < 1:
        solution = replace(
            solution,
            success=False,
            message=f"a fraction of {fraction:g} of the request is met; {solution.message}",
            residual=solution.residual + (1 - fraction) * goal.displacement / unit,
            status=Status.PARTIAL,
            fraction=fraction,
        )
    error = (solution.residual * unit).ravel()
    if goal.part_rotations is not None:
        weight = goal.part_rotations.weight[goal.part_rotations.weight > 0]
        error = np.append(error, weight * goal.angle_errors(np.asarray(solution.predicted)))
    rms = float(np.sqrt(np.mean(error**2)))
    return CycleResult(solution.cycle, solution, solution.message, rms, goal.size, fraction)


def refusal(goal: Goal, solution: Solution, rest: PlateCycle) -> CycleResult:
    """Return a `CycleResult` with a cycle at rest. The cycle at rest replaces a solution in which a
    part would leave the plate."""
    message = "a part would leave the plate: one cycle at rest"
    unit = goal.friction_accel[:, None] * rest.period**2
    solution = replace(
        solution,
        success=False,
        message=message,
        cycle=rest,
        residual=goal.displacement / unit,
        status=Status.FAILED,
        fraction=0.0,
    )
    requested = 0.0 if goal.multi_cycle else goal.size
    return CycleResult(rest, solution, message, requested, requested, 0.0)
