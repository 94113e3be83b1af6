"""A goal: what one cycle is to do with the parts' places and angles, judged on the cycle map.

Averages hold only where parts hardly move within a cycle, and many parts need long cycles. So the
displacement over the cycle itself is asked for, from the state in which it starts (3.1.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from plate_core import PlateCycle, PlateError

from ..cycle_map import (
    end_state,
    end_state_gradient,
    end_turning,
    end_turning_gradient,
    finely_sampled,
)
from ..fit import Fit, fit
from .ends import Ends, end_errors
from .solution import Solution

COMING_M = 0.05
"""Parts further apart than they are to be by this come no nearer than that within a cycle [m]."""


@dataclass(frozen=True)
class Turns:
    """What one cycle is to do with the angles of M parts.

    Attributes
    ----------
    spin : (M,)
        At the start of the cycle [rad/s].
    spread : (M, 3)
        Second moments xx, xy, yy of their contacts then [m2], as they lie in plate_home.
    low, high : (M,)
        Any turn over the cycle between is as good [rad].
    weight : (M,)
        What a radian beside it counts [m]; 0: any turn will do.
    """

    spin: np.ndarray
    spread: np.ndarray
    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Middle of the wanted turns (M,) [rad]; 0 where any will do."""
        return np.where(self.weight > 0, (self.low + self.high) / 2, 0.0)

    @property
    def count(self) -> int:
        """How many are to turn."""
        return int(np.count_nonzero(self.weight))

    def shifted(self, way: np.ndarray | float) -> Turns:
        """Return the same for turns that are greater by `way` (M,) [rad]."""
        return replace(self, low=self.low + way, high=self.high + way)


@dataclass(frozen=True)
class Goal:
    """What one cycle is to do with M parts.

    Attributes
    ----------
    position, velocity : (M, 2)
        Parts at the start of the cycle [m], [m/s], plate_home.
    displacement : (M, 2)
        Wanted displacement over the cycle [m].
    tolerance : (M, 2)
        Any displacement within +-tolerance [m] is as good.
    friction_accel : (M,)
        mu g of each part [m/s2]; one number stands for all.
    turns : Turns, optional
        What is to become of the parts' angles; None where parts may be taken for points.
    lasting : bool
        Whether it is for many cycles: then no motion misses it, but leaves more or less of it.
    weight : (M, 2)
        What a metre that is missed counts [-]; one number stands for all.
    edge : (2,) or (M, 2)
        No part is to end further from the middle along x and y [m]; infinite if left out.
    clear : (M, M) or float
        No two parts are to end with their centres nearer to each other [m].
    coast : float
        Where parts end counts as if they kept their last velocity and spin for so long [s].
    plate : (3, 3), optional
        State of the plate at the start, as `PlateCycle.state`; None: at rest.
    free_end : bool
        Whether the plate may end in any state; else at rest.

    Raises
    ------
    PlateError
        If a weight is negative, infinite or no number.
    """

    position: np.ndarray
    velocity: np.ndarray
    displacement: np.ndarray
    tolerance: np.ndarray
    friction_accel: np.ndarray
    turns: Turns | None = None
    lasting: bool = False
    weight: np.ndarray | float = 1.0
    edge: np.ndarray | float = np.inf
    clear: np.ndarray | float = 0.0
    coast: float = 0.0
    plate: np.ndarray | None = None
    free_end: bool = False

    def __post_init__(self) -> None:
        same = np.broadcast_to(self.friction_accel, len(self.position))
        object.__setattr__(self, "friction_accel", np.array(same, dtype=float))
        for of, weight in (("", self.weight), (" of turns", getattr(self.turns, "weight", 0.0))):
            values = np.atleast_1d(weight)
            wrong = values[~((values >= 0) & (values < np.inf))]
            if len(wrong):
                raise PlateError(f"weight{of} has {wrong[0]:g}, allowed: 0 and above")

    @cached_property
    def ends(self) -> Ends:
        """What is asked of the parts' places at the end."""
        shape, middle = self.position.shape, self.position + self.displacement

        def flat(values: np.ndarray | float) -> np.ndarray:
            return np.broadcast_to(values, shape).T.ravel()

        low, high = middle - self.tolerance, middle + self.tolerance
        weighed = np.broadcast_to(self.weight, shape) > 0
        beyond = np.where(weighed, [-high, low], -np.inf)
        below, above = np.maximum(self.edge, beyond)  # not where a part is to be beyond
        gap = self.position[None] - self.position[:, None]
        clear = np.broadcast_to(self.clear, (len(middle), len(middle)))
        near = np.hypot(gap[..., 0], gap[..., 1]) < clear + COMING_M
        pair = np.ascontiguousarray(np.argwhere(np.triu(near & (clear > 0), 1)))
        wanted = np.array([flat(low), flat(high), flat(self.weight), flat(-below), flat(above)])
        if self.turns is not None:
            turns, free = self.turns, np.full(len(self.position), np.inf)
            angles = np.array([turns.low, turns.high, turns.weight, -free, free])
            wanted = np.ascontiguousarray(np.hstack([wanted, angles]))
        low, high, weight, edge_low, edge_high = wanted
        clear = clear[pair[:, 0], pair[:, 1]]
        return Ends(low, high, weight, edge_low, edge_high, pair, clear, len(self.position))

    @property
    def rows(self) -> int:
        """Number of errors: two for each part, or three where angles count."""
        return self.position.size + (0 if self.turns is None else len(self.position))

    @property
    def asked(self) -> int:
        """Number of errors that are not always 0."""
        return self.position.size + (0 if self.turns is None else self.turns.count)

    @property
    def size(self) -> float:
        """What is asked, root mean square over displacements and turns by their weights [m]."""
        asked = self.displacement.ravel()
        if self.turns is not None:
            arc = self.turns.weight * self.turns.middle
            asked = np.concatenate([asked, arc[self.turns.weight > 0]])
        return float(np.sqrt(np.mean(asked**2)))

    def times(self, fraction: float) -> Goal:
        """Return a goal that asks for less: for a fraction of the displacements; of a lasting one
        for ways that count less beside edges and other parts."""
        turns = self.turns
        if self.lasting:
            if turns is not None:
                turns = replace(turns, weight=fraction**2 * turns.weight)
            return replace(self, weight=fraction**2 * self.weight, turns=turns)
        if turns is not None:
            turns = turns.shifted((fraction - 1) * turns.middle)
        return replace(self, displacement=fraction * self.displacement, turns=turns)

    def downhill(self, most: float) -> np.ndarray:
        """Return the displacements (M, 2) [m] that make errors less most quickly, the longest of
        which is `most` [m]."""
        place = (self.position + self.coast * self.velocity).T.ravel()
        if self.turns is not None:
            place = np.append(place, self.coast * self.turns.spin)
        error, slope = end_errors(place, self.ends)
        way = (error @ slope)[: self.position.size].reshape(2, -1).T
        return np.asarray(way * (most / max(float(np.max(np.hypot(*way.T))), 1e-12)))

    def left(self, end: np.ndarray) -> np.ndarray:
        """Return how far (M, 2) [m] an end is from what is asked, signed."""
        miss = self.position + self.displacement - end[: self.position.size].reshape(2, -1).T
        beyond = np.sign(miss) * np.maximum(np.abs(miss) - self.tolerance, 0.0)
        return np.where(np.asarray(self.weight) > 0, beyond, 0.0)

    def left_to_turn(self, end: np.ndarray) -> np.ndarray:
        """Return by how much (Q,) [rad] the turns that are asked are missed, signed."""
        if self.turns is None:
            return np.zeros(0)
        turns, turn = self.turns, end[self.position.size :]
        return (np.clip(turn, turns.low, turns.high) - turn)[turns.weight > 0]

    def shifted(self, way: np.ndarray) -> Goal:
        """Return the goal to end elsewhere: by `way` (C,) [m, rad], as `end` gives it."""
        places = self.position.size
        shift = way[:places].reshape(2, -1).T
        turns = None if self.turns is None else self.turns.shifted(way[places:])
        return replace(self, displacement=self.displacement + shift, turns=turns)

    def end(self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Predict the end (C,) of a sampled motion: x of all parts [m], y of all, then, where
        angles count, the turns of all [rad]."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            place, velocity = end_state(self.position, self.velocity, *moved)
            return (place + self.coast * velocity).T.ravel()
        place, velocity, turn, spin = end_turning(
            self.position, self.velocity, self.turns.spin, self.turns.spread, *moved
        )
        place += self.coast * velocity
        return np.concatenate([place.T.ravel(), turn + self.coast * spin])

    def end_slopes(
        self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the derivatives of `end` by pose (2, n, C), twist (3, n, C) and dt (n, C)."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            return end_state_gradient(self.position, self.velocity, *moved, self.coast)
        return end_turning_gradient(
            self.position, self.velocity, self.turns.spin, self.turns.spread, *moved, self.coast
        )

    def error(self, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (R,) of an end [m], and minus their derivatives (R, C)."""
        return end_errors(end, self.ends)


class Family(Protocol):
    """A family of closed motions with parameters (P,)."""

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of steps (n,) [s], and these."""

    def pull_back(
        self, parameters: np.ndarray, by_pose: np.ndarray, by_twist: np.ndarray, by_dt: np.ndarray
    ) -> np.ndarray:
        """Turn derivatives by the samples, (c, n, R) and (n, R), into ones (R, P)."""

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Return the nearest parameters that the rig can run."""

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return further errors (K,) [m]."""

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (K, P) of minus the further errors."""


def fit_goal(
    goal: Goal, family: Family, parameters: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Correct a motion until the parts go where they are to go.

    Errors are those of `Goal.error` and the family's own [m]; `tolerance` is the greatest at which
    to stop [m].
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        samples = family.samples(theta)
        error, slope = goal.error(goal.end(*samples))

        def slopes() -> np.ndarray:
            jacobian = family.pull_back(theta, *goal.end_slopes(*samples))
            return np.vstack([slope @ jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error, family.penalty(theta)]), slopes

    return fit(evaluate, family.admissible, parameters, tolerance, iterations)


def goal_solution(
    goal: Goal, cycle: PlateCycle, good_enough: float, iterations: int, condition: float
) -> Solution:
    """Put a finished cycle, within the limits, into a solution: judged by a finer prediction than
    the search's.

    `residual` is what is left / (mu g T^2); `success` is said of the root mean square error [m].
    """
    end = goal.end(*finely_sampled(cycle))
    left, unit = goal.left(end), goal.friction_accel[:, None] * cycle.period**2
    error, _ = goal.error(end)
    if goal.lasting:
        message = f"{1e3 * float(np.sqrt(np.mean(left**2))):.3g} mm to go"
        if goal.turns is not None and goal.turns.count:
            turn = float(np.sqrt(np.mean(goal.left_to_turn(end) ** 2)))
            message += f", {np.degrees(turn):.2g} deg to turn"
    else:
        message = f"displacement error {1e3 * float(np.max(np.abs(error))):.3g} mm"
    return Solution(
        success=goal.lasting or bool(np.sqrt(np.sum(error**2) / goal.asked) <= good_enough),
        message=f"{message} after {iterations} iterations",
        cycle=cycle,
        residual=left / unit,
        iterations=iterations,
        condition=condition,
        predicted=end,
    )
