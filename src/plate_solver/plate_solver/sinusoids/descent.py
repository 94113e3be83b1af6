"""One descent of a sinusoidal motion on the cycle map, compiled from start to finish.

Samples, the map and its derivatives, what is asked of the parts' ends, the rig's limits and the
steps of Levenberg and Marquardt: all in one call, as each takes some ten microseconds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from plate_core.kernels import kernel

from ..fit import Damping, Fit, levenberg_marquardt
from ..limits import EQUAL_WEIGHT, Limits, limit_use
from ..maps import (
    LANES,
    TRACE,
    TURNING_TRACE,
    adjoint,
    adjoint_turning,
    blocks_of,
    trace,
    trace_turning,
    turning_blocks_of,
)
from ..maps.turning import TURN
from ..requests import Ends, Goal, end_errors
from .basis import SinusoidBasis
from .limits import EXCESS_M, LOOKS_PER_HARMONIC, excess, force_excess

BIN = 4
"""Steps whose derivatives are summed before they meet the basis."""

DAMPING = Damping(1e-2, 1e-6, 1e3, 3.0, 4.0, 6, 0.9999)
"""Where what is left is much more than what a cycle can do, a step gains little of it."""


class Motions(NamedTuple):
    """A basis of sinusoidal motions, and the limits that it presses against.

    Attributes
    ----------
    pose, twist : (n, h)
        The basis at the middles of steps.
    pose_bins, twist_bins : (n / BIN, h)
        Its means over bins.
    looks : (3, k, h)
        Pose, twist and acceleration at the instants at which limits are looked at.
    scale : (3,)
        Coefficients of a parameter along x, y and theta.
    dt : float
        Length of a step [s].
    limits : Limits
    """

    pose: np.ndarray
    twist: np.ndarray
    pose_bins: np.ndarray
    twist_bins: np.ndarray
    looks: np.ndarray
    scale: np.ndarray
    dt: float
    limits: Limits

    @classmethod
    def of(cls, basis: SinusoidBasis, limits: Limits) -> Motions:
        """Take a basis whose number of steps is a multiple of `BIN`."""
        every = max(1, basis.steps // (LOOKS_PER_HARMONIC * (basis.size // 2 + 1)))
        pose_bins, twist_bins = (
            np.ascontiguousarray(matrix.reshape(-1, BIN, basis.size).mean(axis=1))
            for matrix in (basis.pose, basis.twist)
        )
        looks = [matrix[::every] for matrix in (basis.pose, basis.twist, basis.accel)]
        scale = np.array([1.0, 1.0, 1 / limits.arm_m])
        return cls(
            basis.pose, basis.twist, pose_bins, twist_bins, np.array(looks), scale, basis.dt, limits
        )


class Problem(NamedTuple):
    """What a descent is to do.

    Attributes
    ----------
    motions : Motions
    start : (b, STATE) or (b, TURNING_STATE)
        Parts at the start, in blocks.
    parts : int
        How many.
    turning : bool
        Whether their angles count.
    ends : Ends
    coast : float
        [s].
    most : float
        Fraction of the limits that may be used on the way.
    steps, by_twist, by_pose
        Room for `trace` and `adjoint`.
    """

    motions: Motions
    start: np.ndarray
    parts: int
    turning: bool
    ends: Ends
    coast: float
    most: float
    steps: np.ndarray
    by_twist: np.ndarray
    by_pose: np.ndarray

    @classmethod
    def of(cls, goal: Goal, motions: Motions, most: float) -> Problem:
        """Take a goal."""
        state = goal.position, goal.velocity, goal.friction_accel, motions.dt
        turns, axes, size = goal.turns, 2, TRACE
        if turns is None:
            start = blocks_of(*state)
        else:
            start, axes, size = (
                turning_blocks_of(*state, turns.spin, turns.spread),
                3,
                TURNING_TRACE,
            )
        blocks, bins = len(start), len(motions.pose_bins)
        return cls(
            motions, start, len(goal.position), turns is not None, goal.ends, goal.coast, most,
            np.empty((len(motions.pose), blocks, size)),
            np.empty((bins, blocks, axes, 3 * LANES)), np.empty((bins, blocks, axes, 2 * LANES)),
        )  # fmt: skip


class Notes(NamedTuple):
    """What slopes need of an evaluation: twists (n, 3), minus the derivatives of the ends' errors
    (R, C), those of the excesses by the coefficients (K, h, 3)."""

    twist: np.ndarray
    by_place: np.ndarray
    by_own: np.ndarray


@njit(error_model="numpy")
def _use(theta: np.ndarray, motions: Motions) -> float:
    """Return the greatest fraction of a limit that is used where limits are looked at."""
    own, looks = theta.reshape(-1, 3) * motions.scale, motions.looks
    return limit_use(
        looks[0] @ own, looks[1] @ own, looks[2] @ own, EQUAL_WEIGHT, motions.limits, True
    )


@njit(error_model="numpy")
def _evaluate(problem: Problem, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, Notes]:
    """Return the motion scaled to what limits it may use, its errors [m], and notes."""
    motions, count = problem.motions, problem.parts
    theta = theta * min(1.0, problem.most / max(_use(theta, motions), 1e-300))
    own = theta.reshape(-1, 3) * motions.scale
    twist, state = motions.twist @ own, problem.start.copy()
    if problem.turning:
        trace_turning(state, motions.pose @ own, twist, motions.dt, problem.steps)
    else:
        trace(state, motions.pose @ own, twist, motions.dt, problem.steps)
    place = np.empty(problem.by_twist.shape[2] * count)
    for axis in range(2):
        for i in range(count):
            block, lane = i // LANES, axis * LANES + i % LANES
            place[axis * count + i] = (
                state[block, lane] + problem.coast * state[block, 2 * LANES + lane]
            )
    if problem.turning:
        for i in range(count):
            block, lane = i // LANES, TURN + i % LANES
            place[2 * count + i] = state[block, lane] + problem.coast * state[block, LANES + lane]
    error, by_place = end_errors(place, problem.ends)
    looks, limits = motions.looks, motions.limits
    over, by_own = excess(own, looks[0], looks[1], looks[2], limits)
    if limits.forceful:
        more, by_force = force_excess(own, looks[0], looks[1], looks[2], limits)
        over, by_own = np.concatenate((over, more)), np.concatenate((by_own, by_force))
    return theta, np.concatenate((error, -EXCESS_M * over)), Notes(twist, by_place, by_own)


@njit(error_model="numpy")
def _slopes(problem: Problem, theta: np.ndarray, notes: Notes) -> np.ndarray:
    """Return minus the derivatives (R + K, 3 h) of the errors."""
    motions, count = problem.motions, problem.parts
    size, scale = motions.pose.shape[1], motions.scale
    if problem.turning:
        adjoint_turning(
            problem.steps, notes.twist, motions.dt, problem.coast, problem.by_twist, problem.by_pose
        )
    else:
        adjoint(
            problem.steps, notes.twist, motions.dt, problem.coast, problem.by_twist, problem.by_pose
        )
    bins, blocks, axes, _ = problem.by_twist.shape
    on_twist = motions.twist_bins.T @ problem.by_twist.reshape(bins, -1)
    on_pose = motions.pose_bins.T @ problem.by_pose.reshape(bins, -1)
    by_twist = on_twist.reshape(size, blocks, axes, 3 * LANES)
    by_pose = on_pose.reshape(size, blocks, axes, 2 * LANES)
    ends = np.empty((axes * count, 3 * size))
    for axis in range(axes):
        for i in range(count):
            block, lane, row = i // LANES, i % LANES, ends[axis * count + i]
            for h in range(size):
                for c in range(3):
                    slope = by_twist[h, block, axis, c * LANES + lane]
                    if c < 2:
                        slope += by_pose[h, block, axis, c * LANES + lane]
                    row[3 * h + c] = scale[c] * slope
    rows = len(notes.by_place)
    jacobian = np.empty((rows + len(notes.by_own), 3 * size))
    jacobian[:rows] = notes.by_place @ ends
    for k in range(len(notes.by_own)):
        for h in range(size):
            for c in range(3):
                jacobian[rows + k, 3 * h + c] = EXCESS_M * notes.by_own[k, h, c] * scale[c]
    return jacobian


_search_down = njit(error_model="numpy", inline="always")(levenberg_marquardt(_evaluate, _slopes))


@kernel(error_model="numpy")
def descend(problem: Problem, theta: np.ndarray, tolerance: float, iterations: int) -> Fit:
    """Improve a motion (3 h,) until no part misses more than `tolerance` [m], or it helps no more.

    The errors of the result are those of the ends, and then limits that are exceeded.
    """
    return _search_down(problem, theta, DAMPING, tolerance, iterations)
