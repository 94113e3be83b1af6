"""Steering: the plate motion whose true stick-slip cycle moves each part by what is asked.

Averages hold only where parts hardly move within a cycle, and many parts need long cycles. So we
ask for the displacement over the cycle itself, from the state in which it starts, and correct any
family of motions with exact derivatives of the cycle map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from plate_core import PlateCycle

from .cycle_map import end_position_gradient, end_state
from .least_squares import Fit, fit
from .solution import Bounds, Solution, within_limits
from .turning import State, Turns
from .turning import ends as disc_ends
from .turning import slopes as disc_slopes

INSIDE_WEIGHT = 0.02
"""Weight of an error within its tolerance: enough to prefer the middle, too little to cost."""


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

    def times(self, share: float) -> Goal:
        """Return a share of what is asked."""
        turns = None if self.turns is None else self.turns.times(share)
        return replace(self, displacement=share * self.displacement, turns=turns)


class Family(Protocol):
    """A family of closed motions with parameters (P,)."""

    @property
    def dt(self) -> float:
        """Length of a step [s]."""

    def samples(self, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose and twist (n, 3) at the middles of the steps."""

    def pull_back(
        self, parameters: np.ndarray, by_twist: np.ndarray, by_pose: np.ndarray | None
    ) -> np.ndarray:
        """Turn derivatives by twist (R, n, 3) and position (R, n, 2) into ones (R, P)."""

    def admissible(self, parameters: np.ndarray) -> np.ndarray:
        """Return the nearest parameters that the rig can run."""

    def penalty(self, parameters: np.ndarray) -> np.ndarray:
        """Return further errors (K,) [m]."""

    def penalty_slopes(self, parameters: np.ndarray) -> np.ndarray:
        """Return the derivative (K, P) of minus the further errors."""


def residual(goal: Goal, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the error (M, 2) [m] of end positions beyond the tolerance, and its weights."""
    miss = goal.displacement - (end - goal.position)
    outside = np.abs(miss) > goal.tolerance
    error = np.where(
        outside, miss - np.sign(miss) * goal.tolerance * (1 - INSIDE_WEIGHT), INSIDE_WEIGHT * miss
    )
    return error, np.where(outside, 1.0, INSIDE_WEIGHT)


def residual_with_turns(goal: Goal, turns: Turns, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (2 M + Q,) [m] of places and turns, and their weights."""
    end, missed = disc_ends(turns, state)
    error, weight = residual(goal, end)
    return (
        np.concatenate([error.ravel(), missed]),
        np.concatenate([weight.ravel(), np.ones(len(missed))]),
    )


def steer(
    goal: Goal, family: Family, parameters: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Correct a motion until the parts' displacements are as asked.

    Errors are in metres; `tolerance` is the greatest at which to stop [m].
    """

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        pose, twist = family.samples(theta)
        if goal.turns is not None:
            return with_turns(theta, goal.turns, pose, twist)
        state = goal.position, goal.velocity, pose, twist, family.dt, goal.friction_accel
        end, _ = end_state(*state)
        error, weight = residual(goal, end)

        def slopes() -> np.ndarray:
            _, _, by_twist, by_pose = end_position_gradient(*state)
            jacobian = weight.reshape(-1, 1) * family.pull_back(theta, by_twist, by_pose)
            return np.vstack([jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error.ravel(), family.penalty(theta)]), slopes

    def with_turns(
        theta: np.ndarray, turns: Turns, pose: np.ndarray, twist: np.ndarray
    ) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        dt = np.full(len(pose), family.dt)
        state = goal.position, goal.velocity, pose, twist, dt, goal.friction_accel
        error, weight = residual_with_turns(goal, turns, state)

        def slopes() -> np.ndarray:
            by_pose, by_twist, _ = disc_slopes(turns, state)
            jacobian = weight[:, None] * family.pull_back(theta, by_twist, by_pose)
            return np.vstack([jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error, family.penalty(theta)]), slopes

    return fit(evaluate, parameters, family.admissible, tolerance, iterations)


def steering_solution(
    bounds: Bounds,
    goal: Goal,
    best: Fit,
    cycle: PlateCycle,
    good_enough: float,
    iterations: int,
    condition: float,
) -> Solution:
    """Put the result of `steer` into a solution; its residual is error / (mu g T^2)."""
    every = best.error[: goal.rows]
    error = every[: goal.position.size].reshape(-1, 2)
    worst = float(np.max(np.abs(every)))
    return Solution(
        success=bool(np.sqrt(np.mean(every**2)) <= good_enough),
        message=f"displacement error {worst * 1e3:.3g} mm after {iterations} iterations",
        cycle=within_limits(bounds, cycle),
        residual=error / (goal.friction_accel[:, None] * cycle.period**2),
        iterations=iterations,
        condition=condition,
    )
