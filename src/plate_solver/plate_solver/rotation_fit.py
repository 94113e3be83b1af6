"""Corrections of sequences of rotations: on the averaged map and on the cycle map."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from plate_core import PlateCycle

from .averaged import CURL_LENGTH_M
from .cycle_map import end_state
from .least_squares import Fit, fit
from .rotation_descent import descend
from .rotation_family import RotationFamily
from .solution import Request
from .steering import Goal, residual, residual_with_turns
from .stepped_map import end_position_slopes, end_positions, mean_forces
from .turning import State, Turns
from .turning import slopes as disc_slopes

STEP = 0.1e-3
"""Step of the prediction that an answer is given with [s]: finer than the search's."""


def fit_displacement(
    goal: Goal, family: RotationFamily, parameters: np.ndarray, tolerance: float, iterations: int
) -> Fit:
    """Correct a sequence until the parts' displacements are as asked; errors in metres."""

    def evaluate(theta: np.ndarray) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        state = goal.position, goal.velocity, *family.samples(theta), goal.friction_accel
        if goal.turns is not None:
            return with_turns(theta, goal.turns, state)
        error, weight = residual(goal, end_positions(*state))

        def slopes() -> np.ndarray:
            jacobian = family.pull_back(theta, *end_position_slopes(*state))
            return np.vstack([weight.reshape(-1, 1) * jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error.ravel(), family.penalty(theta)]), slopes

    def with_turns(
        theta: np.ndarray, turns: Turns, state: State
    ) -> tuple[np.ndarray, Callable[[], np.ndarray]]:
        error, weight = residual_with_turns(goal, turns, state)

        def slopes() -> np.ndarray:
            jacobian = family.pull_back(theta, *disc_slopes(turns, state))
            return np.vstack([weight[:, None] * jacobian, family.penalty_slopes(theta)])

        return np.concatenate([error, family.penalty(theta)]), slopes

    return fit(evaluate, parameters, family.admissible, tolerance, iterations)


def fit_mean_force(
    request: Request,
    family: RotationFamily,
    parameters: np.ndarray,
    tolerance: float,
    iterations: int,
) -> Fit:
    """Correct a sequence until its average forces (5) are as asked; errors in mu m g."""
    wanted = np.column_stack([request.force, request.curl]).ravel()
    scale = np.tile([1.0, 1.0, CURL_LENGTH_M], len(request.position))
    return Fit(
        *descend(
            parameters, family.plain, request.position, request.velocity, wanted, request.rows,
            scale, tolerance, iterations,
        )
    )  # fmt: skip


def mean_force_error(
    request: Request, family: RotationFamily, parameters: np.ndarray
) -> np.ndarray:
    """Return what is missed in the rows `request.rows` [mu m g], curls by `CURL_LENGTH_M`."""
    _, twist, dt = family.samples(parameters)
    got = mean_forces(request.position, request.velocity, twist, dt).ravel()
    wanted = np.column_stack([request.force, request.curl]).ravel()
    scale = np.tile([1.0, 1.0, CURL_LENGTH_M], len(request.position))
    return ((wanted - got) * scale)[request.rows]


def missed(goal: Goal, cycle: PlateCycle) -> np.ndarray:
    """Return the errors (R,) [m] of a finished cycle beyond the goal's tolerance."""
    steps = max(1, round(cycle.period / STEP))
    dt = cycle.period / steps
    t = (np.arange(steps) + 0.5) * dt
    if goal.turns is not None:
        motion = cycle.pose(t), cycle.twist(t), np.full(steps, dt)
        state = goal.position, goal.velocity, *motion, goal.friction_accel
        return residual_with_turns(goal, goal.turns, state)[0]
    end, _ = end_state(
        goal.position, goal.velocity, cycle.pose(t), cycle.twist(t), dt, goal.friction_accel
    )
    return residual(goal, end)[0].ravel()
