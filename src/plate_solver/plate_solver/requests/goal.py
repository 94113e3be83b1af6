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

from plate_core import PlateCycle

from ..fit import Fit, fit
from ..maps import (
    end_disc,
    end_disc_gradient,
    end_state,
    end_state_gradient,
    finely_sampled,
)
from ..maps.disc import POINTS
from .ends import Ends, end_errors
from .solution import Solution

COMING_M = 0.05
"""Parts further apart than they are to be by this come no nearer than that within a cycle [m]."""


@dataclass(frozen=True)
class Turns:
    """What one cycle is to do with the angles of M round parts.

    Attributes
    ----------
    spin : (M,)
        At the start of the cycle [rad/s].
    wanted : (M,)
        Turn over the cycle [rad]; NaN where any will do.
    radius : float
        Of the parts [m].
    """

    spin: np.ndarray
    wanted: np.ndarray
    radius: float

    @property
    def asked(self) -> np.ndarray:
        """Which parts (M,) are to turn."""
        return np.isfinite(self.wanted)

    @property
    def count(self) -> int:
        """How many are to turn."""
        return int(np.count_nonzero(self.asked))

    @property
    def points(self) -> np.ndarray:
        """Points (k, 2) of a part [m]."""
        return np.asarray(self.radius * POINTS)

    @property
    def arc(self) -> np.ndarray:
        """What is asked, as ways of the rims (Q,) [m]."""
        return np.asarray(self.radius * self.wanted[self.asked])

    def times(self, fraction: float) -> Turns:
        """Return a fraction of what is asked."""
        return Turns(self.spin, fraction * self.wanted, self.radius)


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
    edge : (2,)
        No part is to end further from the middle along x and y [m]; infinite if left out.
    clear : float
        No two parts are to end with their centres nearer to each other [m].
    coast : float
        Where parts end counts as if they kept their last velocity for so long [s].
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
    clear: float = 0.0
    coast: float = 0.0

    def __post_init__(self) -> None:
        same = np.broadcast_to(self.friction_accel, len(self.position))
        object.__setattr__(self, "friction_accel", np.array(same, dtype=float))

    @cached_property
    def ends(self) -> Ends:
        """What is asked of the parts' places at the end."""
        shape, middle = self.position.shape, self.position + self.displacement

        def flat(values: np.ndarray | float) -> np.ndarray:
            # A copy in any case: numba would compile everything again for what cannot be written.
            return np.array(np.broadcast_to(values, shape).T, order="C").ravel()

        low, high = middle - self.tolerance, middle + self.tolerance
        edge = np.maximum(self.edge, np.maximum(low, -high))  # not where a part is to be beyond
        gap = self.position[None] - self.position[:, None]
        near = np.hypot(gap[..., 0], gap[..., 1]) < self.clear + COMING_M
        pair = np.ascontiguousarray(np.argwhere(np.triu(near & (self.clear > 0), 1)))
        return Ends(
            flat(low), flat(high), flat(self.weight), flat(-edge), flat(edge), pair, self.clear
        )

    @property
    def rows(self) -> int:
        """Number of errors: two for each part, one for each turn that is asked."""
        return self.position.size + (0 if self.turns is None else self.turns.count)

    @property
    def size(self) -> float:
        """What is asked, root mean square over displacements and ways of rims [m]."""
        asked = self.displacement.ravel()
        if self.turns is not None:
            asked = np.concatenate([asked, self.turns.arc])
        return float(np.sqrt(np.mean(asked**2)))

    def times(self, fraction: float) -> Goal:
        """Return a goal that asks for less: for a fraction of the displacements; of a lasting one
        for ways that count less beside edges and other parts."""
        if self.lasting:
            return replace(self, weight=fraction**2 * self.weight)
        turns = None if self.turns is None else self.turns.times(fraction)
        return replace(self, displacement=fraction * self.displacement, turns=turns)

    def downhill(self, most: float) -> np.ndarray:
        """Return the displacements (M, 2) [m] that make errors less most quickly, the longest of
        which is `most` [m]."""
        place = (self.position + self.coast * self.velocity).T.ravel()
        error, slope = end_errors(place, self.ends)
        way = (error @ slope).reshape(2, -1).T
        return np.asarray(way * (most / max(float(np.max(np.hypot(*way.T))), 1e-12)))

    def left(self, end: np.ndarray) -> np.ndarray:
        """Return how far (M, 2) [m] an end is from what is asked, signed."""
        miss = self.position + self.displacement - end[: self.position.size].reshape(2, -1).T
        beyond = np.sign(miss) * np.maximum(np.abs(miss) - self.tolerance, 0.0)
        return np.where(np.asarray(self.weight) > 0, beyond, 0.0)

    def shifted(self, way: np.ndarray) -> Goal:
        """Return the goal to end elsewhere: by `way` (Q,) [m, rad], as `end` gives it."""
        places = self.position.size
        shift, turns = way[:places].reshape(2, -1).T, self.turns
        if turns is not None:
            wanted = turns.wanted.copy()
            wanted[turns.asked] += way[places:]
            turns = replace(turns, wanted=wanted)
        return replace(self, displacement=self.displacement + shift, turns=turns)

    def end(self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Predict the end (Q,) of a sampled motion: x of all parts [m], y of all, then the turns
        that are asked for [rad]."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            place, velocity = end_state(self.position, self.velocity, *moved)
            return (place + self.coast * velocity).T.ravel()
        turns = self.turns
        place, _, turn, _ = end_disc(self.position, self.velocity, turns.spin, *moved, turns.points)
        return np.concatenate([place.T.ravel(), turn[turns.asked]])

    def end_slopes(
        self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the derivatives of `end` by pose (2, n, Q), twist (3, n, Q) and dt (n, Q)."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            return end_state_gradient(self.position, self.velocity, *moved, self.coast)
        turns = self.turns
        every = end_disc_gradient(self.position, self.velocity, turns.spin, *moved, turns.points)
        places = 2 * len(self.position)
        kept = np.concatenate([np.arange(places), places + np.flatnonzero(turns.asked)])
        by_pose, by_twist, by_dt = (np.ascontiguousarray(array[..., kept]) for array in every)
        return by_pose, by_twist, by_dt

    def error(self, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (R,) of an end [m], and minus their derivatives (R, Q).

        First places, then pairs of parts that are too near, then turns: these count as the arcs
        that they make at the parts' rims.
        """
        places = self.position.size
        error, slope = end_errors(end[:places], self.ends)
        if self.turns is None:
            return error, slope
        turns = self.turns
        missed = turns.radius * (turns.wanted[turns.asked] - end[places:])
        every = np.zeros((len(error) + len(missed), len(end)))
        every[: len(error), :places] = slope
        every[len(error) :, places:] = turns.radius * np.eye(len(missed))
        return np.concatenate([error, missed]), every


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
    else:
        message = f"displacement error {1e3 * float(np.max(np.abs(error))):.3g} mm"
    return Solution(
        success=goal.lasting or bool(np.sqrt(np.mean(error**2)) <= good_enough),
        message=f"{message} after {iterations} iterations",
        cycle=cycle,
        residual=left / unit,
        iterations=iterations,
        condition=condition,
        predicted=end,
    )
