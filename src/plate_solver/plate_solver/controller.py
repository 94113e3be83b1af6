"""From what is asked of the parts to the next plate cycle: predict, steer, check."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plate_core import PlateCycle, PlateError, Rig, Wanted, part_class
from plate_core.motion import is_rest
from plate_core.rig import PartType

from .cycle_map import after, end_turning, finely_sampled, room_spread
from .goal import Goal, Solution, Status, Turns
from .motion_solver import MotionSolver
from .rotations.solver import RotationCycles
from .sinusoids.basis import TAIL_PERIOD_S, TAIL_S
from .sinusoids.solver import SinusoidCycles

METHODS = {"A": "rotations", "B": "sinusoids", "rotations": "rotations", "sinusoids": "sinusoids"}
"""Names of the methods: the paper's letters and ours."""

IDLE_PERIOD = 0.1
"""Length of a cycle at rest [s]."""

DRIFT_TOLERANCE, WAY_TOLERANCE = 5e-5, 2e-4
"""Error over a cycle at which a search stops [m/s]: of exact drifts, and of ways that last."""

FRACTIONS = (1.0, 0.5, 0.25)
"""Fractions of a request that are tried, one after the other, when a part would leave the plate."""

GOOD_MISS = 0.15
"""Fraction of the wanted displacement that may be missed (root mean square) before a solver looks
for other motions than the last one's relatives."""

EXACT_MISS = 0.02
"""The same where a part has no slack at all: such a request is meant exactly."""

MOST_ASKED = 1e9
"""Greatest weight and distance in a request."""

NEAR_M = 0.006
"""Where no part has further to go the plate comes to rest after each cycle [m]: what is reached
then stays so."""

COAST_S = 0.03
"""Where parts end counts as if they kept their last velocity for so long [s]: those that end in a
swing the right way are further than they look. Not where all are nearer than `NEAR_M`: they would
swing for ever where they are to lie."""


EFFORT: dict[str, dict[str, Any]] = {
    "rotations": {"iterations": 20, "restarts": 1},
    "sinusoids": {"iterations": 16, "restarts": 40},
}
"""Most iterations from one start and most further starts: what suits a loop. More take longer, and
buy little: see docs/results.md."""


@dataclass(frozen=True)
class Answer:
    """The next cycle and how it came about.

    Attributes
    ----------
    cycle : PlateCycle
        Starts and ends at rest at home, or, where the state of the plate is certain, goes on from
        it, and has a tail.
    solution : Solution or None
        None where nothing was asked.
    message : str
        For the log.
    error_m, asked_m : float
        Root mean square over parts and axes of the missed and of the wanted displacement; turns
        count as ways of the rim [m].
    fraction : float
        Fraction of the wanted displacement that was aimed at: `FRACTIONS`, or 0 for a cycle at
        rest.
    """

    cycle: PlateCycle
    solution: Solution | None
    message: str
    error_m: float
    asked_m: float
    fraction: float = 1.0


class Controller:
    """Answers images one by one; remembers the parts' velocities from cycle to cycle.

    A camera that fires once per cycle sees where parts are, not how fast they swing at that
    instant. So the velocity at the start of a cycle is predicted from the last one's motion.

    Parameters
    ----------
    rig : Rig
        Plate, friction and limits.
    method : str
        A key of `METHODS`.
    seed : int
        Seed of the solvers' restarts.
    threads : int
        Cores that a search may use.
    **effort
        `iterations`, `restarts` of the solvers, where those of `EFFORT` are not wanted.
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
        self._velocity: dict[str, np.ndarray] = {}
        self._spin: dict[str, float] = {}
        self._types: dict[str, PartType] = {}
        self.method = METHODS[method]

    @property
    def cut_short(self) -> int:
        """Searches that were ended by the time so far."""
        return sum(solver.cut_short for solver in self._solvers.values())

    def reset(self) -> None:
        """Forget all parts and solutions."""
        self._velocity.clear()
        self._spin.clear()
        for solver in self._solvers.values():
            solver.reset()

    def answer(self, wanted: Wanted, running: PlateCycle | None, until: float = math.inf) -> Answer:
        """Return the cycle to run after the one that is running now.

        Parameters
        ----------
        wanted : Wanted
            What is wanted of parts, as the camera saw them at the start of the running cycle.
        running : PlateCycle, optional
            The cycle that runs now; None if the plate is at rest.
        until : float
            Of `MotionSolver.steer`.
        """
        parts = wanted.parts
        if not len(parts):
            self._velocity.clear()
            self._spin.clear()
            return Answer(PlateCycle.rest(IDLE_PERIOD), None, "no parts, plate at rest", 0.0, 0.0)
        solver = self._solvers[self.method]
        targets = wanted.targets
        turning = wanted.forces.torque if targets is None else np.zeros(0)
        if targets is not None and targets.angles is not None:
            turning = targets.angles.weight
        far = self._far(wanted)
        certain = wanted.plate is not None and wanted.start is not None
        goes_on = self.method == "sinusoids" and far and certain
        period = solver.steering_period(
            len(parts), int(np.count_nonzero(turning)), targets is not None, goes_on
        )
        goal = self._goal(wanted, running, period, goes_on, COAST_S if far else 0.0)
        asked = 0.0 if goal.lasting else goal.size
        unit = goal.friction_accel[:, None] * period**2
        missable = GOOD_MISS if np.all(np.any(wanted.forces.tolerance > 0, axis=1)) else EXACT_MISS
        least = period * (WAY_TOLERANCE if goal.lasting else DRIFT_TOLERANCE)
        rest = PlateCycle.rest(period)
        if goal.lasting and not np.any(goal.error(goal.end(*finely_sampled(rest)))[0]):
            return Answer(rest, None, "all are where they are to come: plate at rest", 0.0, 0.0)
        for fraction in FRACTIONS:
            part = goal.times(fraction)
            good = max(missable * fraction * asked, least)
            solution = solver.steer(part, least, good, until)
            end = np.asarray(solution.predicted)
            if not self._leaves_plate(parts.ids, goal, end):
                break
            solver.forget()
        else:
            message = "a part would leave the plate: one cycle at rest"
            solution = replace(
                solution,
                success=False,
                message=message,
                cycle=rest,
                residual=goal.displacement / unit,
                status=Status.FAILED,
                fraction=0.0,
            )
            return Answer(rest, solution, message, asked, asked, 0.0)
        if goal.lasting:
            return Answer(solution.cycle, solution, solution.message, 0.0, 0.0, fraction)
        if fraction < 1:
            solution = replace(
                solution,
                success=False,
                message=f"{fraction:g} of the request; {solution.message}",
                residual=solution.residual + (1 - fraction) * goal.displacement / unit,
                status=Status.PARTIAL,
                fraction=fraction,
            )
        error = (solution.residual * unit).ravel()
        if goal.turns is not None:
            weight = goal.turns.weight[goal.turns.weight > 0]
            error = np.append(error, weight * goal.left_to_turn(end))
        rms = float(np.sqrt(np.mean(error**2)))
        return Answer(solution.cycle, solution, solution.message, rms, asked, fraction)

    def _goal(
        self,
        wanted: Wanted,
        running: PlateCycle | None,
        period: float,
        goes_on: bool,
        coast: float,
    ) -> Goal:
        """Predict the state in which the answer starts, and say what it is to do."""
        parts, targets = wanted.parts, wanted.targets
        start = np.array([self._velocity.get(name, np.zeros(2)) for name in parts.ids])
        position, velocity = parts.position, np.zeros_like(start)
        types = [self._type(name) for name in parts.ids]
        known = parts.friction_limit / np.array([t.mass_kg for t in types])
        own = np.array([t.mu for t in types]) * self._rig.friction.gravity
        friction = np.where(known > 0, known, own)
        turns = self._turns(wanted, types, period)
        if running is not None and turns is not None:
            position, velocity, turn, spin = end_turning(
                position, start, turns.spin, turns.spread, *finely_sampled(running), friction
            )
            turns = replace(turns, spin=spin, spread=self._spread(types, parts.angle + turn))
            if targets is not None:
                turns = turns.shifted(-turn)
        elif running is not None and wanted.start is None:
            position, velocity = after(running, parts.position, start, friction)
        if wanted.start is not None:
            position, velocity = wanted.start.reshape(-1, 2, 2).transpose(1, 0, 2)
        plate = wanted.plate
        if plate is not None and self.method == "rotations":  # it begins when the plate rests
            if not is_rest(plate):
                tail = PlateCycle.stopping(plate, TAIL_S, TAIL_PERIOD_S)
                position, velocity = after(tail, position, velocity, friction)
            plate = None
        self._velocity = dict(zip(parts.ids, velocity, strict=True))
        self._spin = {} if turns is None else dict(zip(parts.ids, turns.spin.tolist(), strict=True))
        radius, half = np.array([t.reach_m for t in types]), self._rig.plate.half
        if targets is not None:
            for name, value in (("weight", targets.weight), ("gap_m", targets.gap_m)):
                if not np.all(np.abs(value) <= MOST_ASKED):
                    raise PlateError(
                        f"{name} of targets is {np.max(np.abs(value)):g}, allowed: at most "
                        f"{MOST_ASKED:g}"
                    )
            return Goal(
                position=position,
                velocity=velocity,
                displacement=(targets.low + targets.high) / 2 - position,
                tolerance=(targets.high - targets.low) / 2,
                friction_accel=friction,
                turns=turns,
                lasting=True,
                weight=targets.weight,
                edge=half - np.array([[self._rig.edge_margin(t.name).wall_m] for t in types]),
                clear=radius[:, None] + radius + targets.gap_m,
                coast=coast,
                plate=plate,
                free_end=goes_on,
            )
        gain = wanted.forces.period / np.array([[t.mass_kg] for t in types])
        displacement = (parts.velocity + gain * wanted.forces.force) * period
        tolerance = gain * wanted.forces.tolerance * period
        # What leads off the plate is not asked for, so it does not keep the others waiting.
        edge = half - radius[:, None]
        low = np.clip(displacement - tolerance, -edge - position, edge - position)
        high = np.clip(displacement + tolerance, -edge - position, edge - position)
        return Goal(
            position=position,
            velocity=velocity,
            displacement=(low + high) / 2,
            tolerance=(high - low) / 2,
            friction_accel=friction,
            turns=turns,
            plate=plate,
        )

    def _far(self, wanted: Wanted) -> bool:
        """Whether a part has far to go, or to turn at its rim, to its target."""
        to, angle = wanted.targets, wanted.parts.angle
        if to is None:
            return False
        place = wanted.parts.position if wanted.start is None else wanted.start[:, :2]
        way = np.maximum(np.maximum(to.low - place, place - to.high), 0.0)
        way = np.hypot(*np.where(to.weight > 0, way, 0.0).T)
        if to.angles is not None:
            turn = np.maximum(np.maximum(to.angles.low - angle, angle - to.angles.high), 0.0)
            reach = np.array([self._type(name).reach_m for name in wanted.parts.ids])
            way = np.maximum(way, np.where(to.angles.weight > 0, reach * turn, 0.0))
        return bool(np.any(way > NEAR_M))

    def _type(self, name: str) -> PartType:
        """Return the type of a part, by its id."""
        label = part_class(name)
        if label not in self._types:
            self._types[label] = self._rig.part_type(label)
        return self._types[label]

    @staticmethod
    def _spread(types: list[PartType], angle: np.ndarray) -> np.ndarray:
        """Return second moments (M, 3) [m2] of parts as they lie at angles (M,) [rad]."""
        return room_spread(np.array([t.spread_m2 for t in types]), angle)

    def _turns(self, wanted: Wanted, types: list[PartType], period: float) -> Turns | None:
        """Return what is to become of the angles, with the spins at the start of the running
        cycle, and turns from the angles that parts have then; None where no turn is asked."""
        parts, to = wanted.parts, wanted.targets
        spin = np.array([self._spin.get(name, 0.0) for name in parts.ids])
        if to is not None:
            if to.angles is None:
                return None
            low, high = to.angles.low - parts.angle, to.angles.high - parts.angle
            return Turns(spin, self._spread(types, parts.angle), low, high, to.angles.weight)
        if not np.any(wanted.forces.torque):
            return None
        inertia = np.array([(t.mass_kg or 0.0) * np.trace(t.spread_m2) for t in types])
        turn = (parts.spin + wanted.forces.period / inertia * wanted.forces.torque) * period
        arc = np.where(wanted.forces.torque != 0, [t.reach_m for t in types], 0.0)
        return Turns(spin, self._spread(types, parts.angle), turn, turn, arc)

    def _leaves_plate(self, ids: tuple[str, ...], goal: Goal, predicted: np.ndarray) -> bool:
        """Whether a part that is well on the plate would be off it after the cycle."""
        end = predicted[: goal.position.size].reshape(2, -1).T
        radius = np.sqrt([[self._type(name).area_m2 / np.pi] for name in ids])
        edge = self._rig.plate.half - 0.5 * radius
        middle = goal.position + goal.displacement
        asked = np.abs(middle) - goal.tolerance > edge  # to leave it there
        out = (np.abs(end) > edge) & ~(asked & (end * middle > 0))
        return bool(np.any(out & (np.abs(end) > np.abs(goal.position))))
