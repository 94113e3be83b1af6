"""A goal: what one cycle is to do with the parts' places and angles, judged on the cycle map.

Averages hold only where parts hardly move within a cycle, and many parts need long cycles. So the
displacement over the cycle itself is asked for, from the state in which it starts (3.1.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
from .solution import Solution

INSIDE_WEIGHT = 0.02
"""Weight of an error within its tolerance: enough to prefer the middle, too little to cost."""


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
    """

    position: np.ndarray
    velocity: np.ndarray
    displacement: np.ndarray
    tolerance: np.ndarray
    friction_accel: np.ndarray
    turns: Turns | None = None

    def __post_init__(self) -> None:
        same = np.broadcast_to(self.friction_accel, len(self.position))
        object.__setattr__(self, "friction_accel", np.array(same, dtype=float))

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
        """Return a fraction of what is asked."""
        turns = None if self.turns is None else self.turns.times(fraction)
        return replace(self, displacement=fraction * self.displacement, turns=turns)

    def end(self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray) -> np.ndarray:
        """Predict the end (Q,) of a sampled motion: x of all parts [m], y of all, then the turns
        that are asked for [rad]."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            place, _ = end_state(self.position, self.velocity, *moved)
            return place.T.ravel()
        turns = self.turns
        place, _, turn, _ = end_disc(self.position, self.velocity, turns.spin, *moved, turns.points)
        return np.concatenate([place.T.ravel(), turn[turns.asked]])

    def end_slopes(
        self, pose: np.ndarray, twist: np.ndarray, dt: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the derivatives of `end` by pose (2, n, Q), twist (3, n, Q) and dt (n, Q)."""
        moved = pose, twist, dt, self.friction_accel
        if self.turns is None:
            return end_state_gradient(self.position, self.velocity, *moved)
        turns = self.turns
        every = end_disc_gradient(self.position, self.velocity, turns.spin, *moved, turns.points)
        places = 2 * len(self.position)
        kept = np.concatenate([np.arange(places), places + np.flatnonzero(turns.asked)])
        by_pose, by_twist, by_dt = (np.ascontiguousarray(array[..., kept]) for array in every)
        return by_pose, by_twist, by_dt

    def error(self, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors (Q,) [m] of an end beyond the tolerance, and minus their derivatives.

        An error of turn counts as the arc that it makes at the part's rim.
        """
        places = self.position.size
        miss = (self.position + self.displacement).T.ravel() - end[:places]
        slack = self.tolerance.T.ravel()
        outside = np.abs(miss) > slack
        beyond = miss - np.sign(miss) * slack * (1 - INSIDE_WEIGHT)
        error = np.where(outside, beyond, INSIDE_WEIGHT * miss)
        weight = np.where(outside, 1.0, INSIDE_WEIGHT)
        if self.turns is None:
            return error, weight
        turns = self.turns
        missed = turns.radius * (turns.wanted[turns.asked] - end[places:])
        return (
            np.concatenate([error, missed]),
            np.concatenate([weight, np.full(len(missed), turns.radius)]),
        )


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
        error, weight = goal.error(goal.end(*samples))

        def slopes() -> np.ndarray:
            jacobian = family.pull_back(theta, *goal.end_slopes(*samples))
            return np.vstack([weight[:, None] * jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error, family.penalty(theta)]), slopes

    return fit(evaluate, family.admissible, parameters, tolerance, iterations)


def goal_solution(
    goal: Goal, cycle: PlateCycle, good_enough: float, iterations: int, condition: float
) -> Solution:
    """Put a finished cycle, within the limits, into a solution: judged by a finer prediction than
    the search's.

    `residual` is error / (mu g T^2); `success` is said of the root mean square error [m].
    """
    end = goal.end(*finely_sampled(cycle))
    error, _ = goal.error(end)
    worst = float(np.max(np.abs(error)))
    unit = goal.friction_accel[:, None] * cycle.period**2
    return Solution(
        success=bool(np.sqrt(np.mean(error**2)) <= good_enough),
        message=f"displacement error {worst * 1e3:.3g} mm after {iterations} iterations",
        cycle=cycle,
        residual=error[: goal.position.size].reshape(2, -1).T / unit,
        iterations=iterations,
        condition=condition,
        predicted=end,
    )
